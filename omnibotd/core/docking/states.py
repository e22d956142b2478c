"""States of docking, what moves between them, and the table of transitions (from which the diagram is drawn)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from omnibotd.core.decision import HomingRequest
from omnibotd.core.geometry import STOP, Twist2D


class State(StrEnum):
    """Named after nav2's docking feedback, with the two ends."""

    INITIAL_PERCEPTION = "INITIAL_PERCEPTION"
    CONTROLLING = "CONTROLLING"
    WAIT_FOR_CHARGE = "WAIT_FOR_CHARGE"
    RETRY = "RETRY"
    DOCKED = "DOCKED"
    FAILED = "FAILED"


class Event(StrEnum):
    """What moves the machine from one state to another."""

    LOCATED = "fixes agree"
    UNSEEN = "fixes don't agree in time"
    DOUBTED = "tracking or confirmation lost"
    STUCK = "not there in time"
    CONFIRMED = "there, no contact to ask"
    CONTACT_DUE = "there, contact expected"
    CHARGING = "charging"
    NOT_CHARGING = "no contact in time"
    BACKED_OUT = "back at the staging pose"
    EXHAUSTED = "no retry left"
    ABORTED = "base, camera or time gone"


_ABORT = {Event.ABORTED: State.FAILED}
TRANSITIONS: Mapping[State, Mapping[Event, State]] = {
    State.INITIAL_PERCEPTION: {
        Event.LOCATED: State.CONTROLLING,
        Event.CHARGING: State.DOCKED,
        Event.UNSEEN: State.RETRY,
        Event.STUCK: State.RETRY,
        **_ABORT,
    },
    State.CONTROLLING: {
        Event.CONFIRMED: State.DOCKED,
        Event.CONTACT_DUE: State.WAIT_FOR_CHARGE,
        Event.CHARGING: State.DOCKED,
        Event.DOUBTED: State.INITIAL_PERCEPTION,
        Event.STUCK: State.RETRY,
        **_ABORT,
    },
    State.WAIT_FOR_CHARGE: {Event.CHARGING: State.DOCKED, Event.NOT_CHARGING: State.RETRY, **_ABORT},
    State.RETRY: {
        Event.BACKED_OUT: State.INITIAL_PERCEPTION,
        Event.CHARGING: State.DOCKED,
        Event.EXHAUSTED: State.FAILED,
        **_ABORT,
    },
    State.DOCKED: {},
    State.FAILED: {},
}


@dataclass(frozen=True, slots=True)
class Action:
    """What a state wants while it lasts; the default is to stand and ask nothing."""

    twist: Twist2D = STOP
    homing: HomingRequest | None = None
    distance_remaining: float | None = None
