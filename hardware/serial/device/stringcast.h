/* The device's side of the link (../README.md), version 3, in portable C99, without heap, clock and port.
 *
 * Call sc_receive for every received byte, and sc_tick from a timer interrupt at least every millisecond. Mask
 * that interrupt during sc_receive, as both use the same struct. Pass `target` to the velocity loops: it is within
 * the limits, and zero unless the state is SC_MOVING or SC_CLAMPED. */
#ifndef STRINGCAST_H
#define STRINGCAST_H

#include <stddef.h>
#include <stdint.h>

#define SC_VERSION 3
#define SC_JOINTS 3
#define SC_MAX_FRAME_BYTES 64 /* bytes between two delimiters */

typedef enum { SC_FRESH, SC_IDLE, SC_MOVING, SC_TRIPPED, SC_LATCHED, SC_CLAMPED } sc_state;

typedef struct {
    sc_state state;
    float target[SC_JOINTS];       /* [rad/s] */
    uint16_t watchdog_ms;          /* longest accepted watchdog */
    float speed[SC_JOINTS];        /* limits set by the host after HELLO [rad/s] */
    float acceleration[SC_JOINTS]; /* [rad/s^2] */
    uint16_t tick_us;              /* of the host */
    uint16_t active_watchdog_ms;   /* 0: no limits set, nothing moves */
    uint32_t last_velocity_us;     /* time of the last obeyed velocity */
    uint16_t last_sequence;        /* of the last velocity, or a later STOP or HELLO */
    uint8_t frame[SC_MAX_FRAME_BYTES];
    size_t length;                 /* bytes in `frame`; SC_MAX_FRAME_BYTES + 1: too many */
} sc_device;

/* Writes the bytes of an answer with delimiter to the port; must not block for long. */
typedef void (*sc_write)(const uint8_t *bytes, size_t count);

/* Call after every reset. */
void sc_init(sc_device *device, uint16_t watchdog_ms);

/* Check the watchdog. now_us wraps at 2^32. */
void sc_tick(sc_device *device, uint32_t now_us);

/* Process a byte from the host. angles: measured [rad]. */
void sc_receive(sc_device *device, uint8_t byte, uint32_t now_us, const float angles[SC_JOINTS], sc_write write);

#endif
