/* The base's side of the protocol: who may move the wheels, and what is told. The rules are numbered in ../PROTOCOL.md,
 * "The base". */
#pragma once

#include "framing.h"

/* This life's number; before any frame. */
void session_init(uint32_t boot_nonce);

/* Obeys one frame, if it makes sense. */
void session_obey(const struct frame *frame);

/* Sends one TELEMETRY, if hands were shaken; `broken` and `overruns` as the decoder counts them. */
void session_report(uint16_t broken, uint16_t overruns);

/* The configuration asked for is stored and in force: acknowledges it. */
void session_configured(void);
