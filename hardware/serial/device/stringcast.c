#include "stringcast.h"

#include <math.h>
#include <string.h>

enum { PING = 0x01, VELOCITY, STOP, LATCH, CLEAR, HELLO, LIMITS, ANSWER = 0x81, GREETING, LIMITED };
enum { HEADER_BYTES = 3, CRC_BYTES = 4, LIMITS_BYTES = 8 * SC_JOINTS + 4 };
enum { MAX_PAYLOAD_BYTES = HEADER_BYTES + LIMITS_BYTES + CRC_BYTES };
enum { ACCELERATION_TICKS = 2 }; /* ticks of velocity change per command, as one may be lost */

static uint32_t crc32(const uint8_t *data, size_t count)
{
    uint32_t crc = 0xFFFFFFFFu;
    while (count--) {
        crc ^= *data++;
        for (int bit = 0; bit < 8; bit++)
            crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
    return ~crc;
}

static void put(uint8_t *to, uint32_t value, size_t count)
{
    for (size_t i = 0; i < count; i++)
        to[i] = (uint8_t)(value >> (8 * i));
}

static uint32_t get(const uint8_t *from, size_t count)
{
    uint32_t value = 0;
    for (size_t i = 0; i < count; i++)
        value |= (uint32_t)from[i] << (8 * i);
    return value;
}

static float get_float(const uint8_t *from)
{
    uint32_t bits = get(from, 4);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static void put_float(uint8_t *to, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    put(to, bits, 4);
}

/* Decode in place; return the length, or 0 for damaged bytes. */
static size_t decode_cobs(uint8_t *data, size_t count)
{
    size_t from = 0, to = 0;
    while (from < count) {
        size_t code = data[from];
        if (code == 0 || from + code > count)
            return 0;
        memmove(data + to, data + from + 1, code - 1);
        to += code - 1;
        from += code;
        if (code < 255 && from < count)
            data[to++] = 0;
    }
    return to;
}

/* Frames are shorter than 254 bytes, so each block ends at a zero. */
static size_t encode_cobs(const uint8_t *data, size_t count, uint8_t *out)
{
    size_t code = 0, to = 1;
    for (size_t i = 0; i < count; i++) {
        if (data[i] != 0) {
            out[to++] = data[i];
            continue;
        }
        out[code] = (uint8_t)(to - code);
        code = to++;
    }
    out[code] = (uint8_t)(to - code);
    out[to++] = 0;
    return to;
}

static void send(uint8_t *payload, size_t count, sc_write write)
{
    uint8_t wire[MAX_PAYLOAD_BYTES + 2];
    put(payload + count, crc32(payload, count), CRC_BYTES);
    write(wire, encode_cobs(payload, count + CRC_BYTES, wire));
}

static void stop_in_state(sc_device *device, sc_state state)
{
    device->state = state;
    memset(device->target, 0, sizeof device->target);
}

static int is_newer(uint16_t sequence, uint16_t last)
{
    uint16_t ahead = (uint16_t)(sequence - last);
    return ahead > 0 && ahead < 0x8000u;
}

static int is_moving(const sc_device *device)
{
    return device->state == SC_MOVING || device->state == SC_CLAMPED;
}

static int accepts_velocity(const sc_device *device)
{
    return device->state == SC_IDLE || is_moving(device);
}

/* Limit a velocity to `speed`, and its change to `change`. */
static float limit_velocity(double wanted, double former, double speed, double change)
{
    double slow = fmin(fmax(wanted, -speed), speed);
    return (float)fmin(fmax(slow, former - change), former + change);
}

static void set_velocity(sc_device *device, uint16_t sequence, const uint8_t *body, uint32_t now_us)
{
    if (!accepts_velocity(device) || !is_newer(sequence, device->last_sequence))
        return;
    uint32_t elapsed = is_moving(device) ? now_us - device->last_velocity_us : 0;
    uint32_t least = (uint32_t)ACCELERATION_TICKS * device->tick_us;
    double span = (double)(elapsed > least ? elapsed : least) * 1e-6;
    device->state = device->state == SC_CLAMPED ? SC_CLAMPED : SC_MOVING;
    for (size_t j = 0; j < SC_JOINTS; j++) {
        float wanted = get_float(body + 4 * j);
        float former = device->target[j];
        device->target[j] = limit_velocity(wanted, former, device->speed[j], device->acceleration[j] * span);
        if (device->target[j] < wanted || device->target[j] > wanted)
            device->state = SC_CLAMPED;
    }
    device->last_sequence = sequence;
    device->last_velocity_us = now_us;
}

static void set_limits(sc_device *device, const uint8_t *body)
{
    uint16_t watchdog = (uint16_t)get(body + 8 * SC_JOINTS + 2, 2);
    for (size_t j = 0; j < 2 * SC_JOINTS; j++)
        if (get_float(body + 4 * j) < 0)
            return;
    if (device->state != SC_IDLE || watchdog == 0)
        return;
    for (size_t j = 0; j < SC_JOINTS; j++) {
        device->speed[j] = get_float(body + 4 * j);
        device->acceleration[j] = get_float(body + 4 * (SC_JOINTS + j));
    }
    device->tick_us = (uint16_t)get(body + 8 * SC_JOINTS, 2);
    device->active_watchdog_ms = watchdog < device->watchdog_ms ? watchdog : device->watchdog_ms;
}

static void clear_limits(sc_device *device)
{
    memset(device->speed, 0, sizeof device->speed);
    memset(device->acceleration, 0, sizeof device->acceleration);
    device->tick_us = 0;
    device->active_watchdog_ms = 0;
}

static void handle_stop(sc_device *device, uint16_t sequence)
{
    if (!accepts_velocity(device))
        return;
    if (is_newer(sequence, device->last_sequence))
        device->last_sequence = sequence;
    stop_in_state(device, SC_IDLE);
}

static void handle_hello(sc_device *device, uint16_t sequence, uint8_t version)
{
    if (device->state == SC_LATCHED || version != SC_VERSION)
        return;
    device->last_sequence = sequence;
    clear_limits(device);
    stop_in_state(device, SC_IDLE);
}

static void apply_command(sc_device *device, uint8_t kind, uint16_t sequence, const uint8_t *body, uint32_t now_us)
{
    switch (kind) {
    case VELOCITY: set_velocity(device, sequence, body, now_us); break;
    case STOP: handle_stop(device, sequence); break;
    case LATCH: stop_in_state(device, SC_LATCHED); break;
    case HELLO: handle_hello(device, sequence, body[0]); break;
    case LIMITS: set_limits(device, body); break;
    case CLEAR:
        if (device->state == SC_LATCHED)
            stop_in_state(device, SC_FRESH);
        break;
    default: break; /* PING */
    }
}

static void send_answer(const sc_device *device, uint16_t sequence, uint32_t now_us, const float *angles,
                        sc_write write)
{
    uint8_t payload[MAX_PAYLOAD_BYTES] = {ANSWER};
    put(payload + 1, sequence, 2);
    put(payload + HEADER_BYTES, now_us, 4);
    payload[HEADER_BYTES + 4] = (uint8_t)device->state;
    for (size_t j = 0; j < SC_JOINTS; j++)
        put_float(payload + HEADER_BYTES + 5 + 4 * j, angles[j]);
    send(payload, HEADER_BYTES + 5 + 4 * SC_JOINTS, write);
}

static void send_greeting(const sc_device *device, uint16_t sequence, sc_write write)
{
    uint8_t payload[MAX_PAYLOAD_BYTES] = {GREETING};
    put(payload + 1, sequence, 2);
    payload[HEADER_BYTES] = SC_VERSION;
    payload[HEADER_BYTES + 1] = SC_JOINTS;
    put(payload + HEADER_BYTES + 2, device->watchdog_ms, 2);
    payload[HEADER_BYTES + 4] = (uint8_t)device->state;
    send(payload, HEADER_BYTES + 5, write);
}

static void send_limits(const sc_device *device, uint16_t sequence, sc_write write)
{
    uint8_t payload[MAX_PAYLOAD_BYTES] = {LIMITED};
    put(payload + 1, sequence, 2);
    for (size_t j = 0; j < SC_JOINTS; j++) {
        put_float(payload + HEADER_BYTES + 4 * j, device->speed[j]);
        put_float(payload + HEADER_BYTES + 4 * (SC_JOINTS + j), device->acceleration[j]);
    }
    put(payload + HEADER_BYTES + 8 * SC_JOINTS, device->tick_us, 2);
    put(payload + HEADER_BYTES + 8 * SC_JOINTS + 2, device->active_watchdog_ms, 2);
    send(payload, HEADER_BYTES + LIMITS_BYTES, write);
}

/* Whether a payload without checksum is a command of the right length with finite numbers. */
static int is_valid_command(const uint8_t *payload, size_t count)
{
    uint8_t kind = payload[0];
    size_t floats = kind == VELOCITY ? SC_JOINTS : kind == LIMITS ? 2 * SC_JOINTS : 0;
    size_t more = kind == LIMITS ? 4 : kind == HELLO ? 1 : 0;
    if (kind < PING || kind > LIMITS || count != HEADER_BYTES + 4 * floats + more)
        return 0;
    for (size_t j = 0; j < floats; j++)
        if (!isfinite(get_float(payload + HEADER_BYTES + 4 * j)))
            return 0;
    return 1;
}

static void process_frame(sc_device *device, uint32_t now_us, const float *angles, sc_write write)
{
    size_t count = decode_cobs(device->frame, device->length);
    if (count < HEADER_BYTES + CRC_BYTES)
        return;
    count -= CRC_BYTES;
    const uint8_t *payload = device->frame;
    if (get(payload + count, CRC_BYTES) != crc32(payload, count) || !is_valid_command(payload, count))
        return;
    uint16_t sequence = (uint16_t)get(payload + 1, 2);
    apply_command(device, payload[0], sequence, payload + HEADER_BYTES, now_us);
    if (payload[0] == HELLO)
        send_greeting(device, sequence, write);
    else if (payload[0] == LIMITS)
        send_limits(device, sequence, write);
    else
        send_answer(device, sequence, now_us, angles, write);
}

void sc_init(sc_device *device, uint16_t watchdog_ms)
{
    memset(device, 0, sizeof *device);
    device->watchdog_ms = watchdog_ms;
    stop_in_state(device, SC_FRESH);
}

void sc_tick(sc_device *device, uint32_t now_us)
{
    uint32_t watchdog = device->active_watchdog_ms ? device->active_watchdog_ms : device->watchdog_ms;
    if (is_moving(device) && now_us - device->last_velocity_us > 1000u * watchdog)
        stop_in_state(device, SC_TRIPPED);
}

void sc_receive(sc_device *device, uint8_t byte, uint32_t now_us, const float angles[SC_JOINTS], sc_write write)
{
    if (byte != 0) {
        if (device->length < SC_MAX_FRAME_BYTES)
            device->frame[device->length] = byte;
        if (device->length <= SC_MAX_FRAME_BYTES)
            device->length++;
        return;
    }
    if (device->length <= SC_MAX_FRAME_BYTES)
        process_frame(device, now_us, angles, write);
    device->length = 0;
}
