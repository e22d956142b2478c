/* Which pin does what, on each of the two boards. The wiring table in README.md says the same for people.
 *
 * The encoders sit in the low half of one port, left A, left B, right A, right B from bit 0, so that one pin-change
 * interrupt reads both wheels at once. Timer 1 makes the PWM, timer 2 the millisecond; timer 0 is free. */
#pragma once

#include <avr/io.h>

#if F_CPU != 16000000UL
#error "timers and baud rate are worked out for 16 MHz"
#endif

#if defined(__AVR_ATmega328P__) /* Uno, Nano */

#define BOARD_NAME "atmega328p"

#define ENCODER_PIN PINC /* A0-A3 */
#define ENCODER_PORT PORTC
#define ENCODER_MASK PCMSK1
#define ENCODER_ENABLE _BV(PCIE1)
#define ENCODER_VECTOR PCINT1_vect

#define PWM_PORT PORTB /* D9 = OC1A left, D10 = OC1B right */
#define PWM_DDR DDRB
#define PWM_LEFT _BV(PB1)
#define PWM_RIGHT _BV(PB2)

#define STANDBY_PORT PORTB /* D8 */
#define STANDBY_DDR DDRB
#define STANDBY _BV(PB0)

#define LEFT_PORT PORTD /* D6, D7 */
#define LEFT_DDR DDRD
#define LEFT_FORWARD _BV(PD6)
#define LEFT_BACKWARD _BV(PD7)

#define RIGHT_PORT PORTB /* D11, D12 */
#define RIGHT_DDR DDRB
#define RIGHT_FORWARD _BV(PB3)
#define RIGHT_BACKWARD _BV(PB4)

#define LIGHT_PORT PORTB /* D13 */
#define LIGHT_DDR DDRB
#define LIGHT _BV(PB5)

#define BUMPER_PIN PIND /* D4 left, D5 right */
#define BUMPER_PORT PORTD
#define BUMPER_LEFT _BV(PD4)
#define BUMPER_RIGHT _BV(PD5)

#define CHARGER_PIN PINC /* A5 */
#define CHARGER _BV(PC5)

#define BATTERY_CHANNEL 4 /* A4 */

#define UART_RX_VECTOR USART_RX_vect
#define UART_TX_VECTOR USART_UDRE_vect

#elif defined(__AVR_ATmega2560__) /* Mega */

#define BOARD_NAME "atmega2560"

#define ENCODER_PIN PINB /* D53, D52, D51, D50 */
#define ENCODER_PORT PORTB
#define ENCODER_MASK PCMSK0
#define ENCODER_ENABLE _BV(PCIE0)
#define ENCODER_VECTOR PCINT0_vect

#define PWM_PORT PORTB /* D11 = OC1A left, D12 = OC1B right */
#define PWM_DDR DDRB
#define PWM_LEFT _BV(PB5)
#define PWM_RIGHT _BV(PB6)

#define STANDBY_PORT PORTA /* D26 */
#define STANDBY_DDR DDRA
#define STANDBY _BV(PA4)

#define LEFT_PORT PORTA /* D22, D23 */
#define LEFT_DDR DDRA
#define LEFT_FORWARD _BV(PA0)
#define LEFT_BACKWARD _BV(PA1)

#define RIGHT_PORT PORTA /* D24, D25 */
#define RIGHT_DDR DDRA
#define RIGHT_FORWARD _BV(PA2)
#define RIGHT_BACKWARD _BV(PA3)

#define LIGHT_PORT PORTB /* D13 */
#define LIGHT_DDR DDRB
#define LIGHT _BV(PB7)

#define BUMPER_PIN PINA /* D28 left, D29 right */
#define BUMPER_PORT PORTA
#define BUMPER_LEFT _BV(PA6)
#define BUMPER_RIGHT _BV(PA7)

#define CHARGER_PIN PINC /* D30 */
#define CHARGER _BV(PC7)

#define BATTERY_CHANNEL 0 /* A0 */

#define UART_RX_VECTOR USART0_RX_vect
#define UART_TX_VECTOR USART0_UDRE_vect

#else
#error "no pins are known for this MCU: add a section to board.h"
#endif
