/* The device's side of the link (../README.md), version 3, in portable C99: no heap, no clock, no port of its own.
 *
 * Call sc_receive for every byte that comes and sc_tick from a timer interrupt, at least every millisecond. Both
 * touch the same struct: where sc_tick may interrupt sc_receive, mask that interrupt around sc_receive. Give the
 * velocity loops `target`, which is zero unless the state is SC_MOVING or SC_CLAMPED, and within the limits. */
#ifndef STRINGCAST_H
#define STRINGCAST_H

#include <stddef.h>
#include <stdint.h>

#define SC_VERSION 3
#define SC_JOINTS 3
#define SC_LONGEST 64 /* bytes between two delimiters */

typedef enum { SC_FRESH, SC_IDLE, SC_MOVING, SC_TRIPPED, SC_LATCHED, SC_CLAMPED } sc_state;

typedef struct {
    sc_state state;
    float target[SC_JOINTS]; /* [rad/s] */
    uint16_t watchdog_ms;   /* the longest that the device bears */
    float speed[SC_JOINTS]; /* limits that the host has set since its HELLO: [rad/s] */
    float acceleration[SC_JOINTS]; /* [rad/s^2] */
    uint16_t tick_us;       /* the host's */
    uint16_t patience_ms;   /* the watchdog in force; 0: the host has set no limits, and nothing moves */
    uint32_t heard_us;      /* when the last velocity was obeyed */
    uint16_t last;          /* its sequence number, or that of a later stop or hello */
    uint8_t frame[SC_LONGEST];
    size_t length;          /* bytes in `frame`; SC_LONGEST + 1: too many came */
} sc_device;

/* The bytes of an answer, delimiter included: the port's own function, which must not block for long. */
typedef void (*sc_write)(const uint8_t *bytes, size_t count);

/* After every reset. */
void sc_init(sc_device *device, uint16_t watchdog_ms);

/* The watchdog. now_us wraps at 2^32. */
void sc_tick(sc_device *device, uint32_t now_us);

/* One byte from the host. angles: measured now [rad]. */
void sc_receive(sc_device *device, uint8_t byte, uint32_t now_us, const float angles[SC_JOINTS], sc_write write);

#endif
