#include "stringcast.h"

#include <math.h>
#include <string.h>

enum { PING = 0x01, VELOCITY, STOP, LATCH, CLEAR, HELLO, LIMITS, ANSWER = 0x81, GREETING, LIMITED };
enum { HEAD = 3, CHECK = 4, BOUNDS = 8 * SC_JOINTS + 4, LARGEST = HEAD + BOUNDS + CHECK };
enum { BEFORE = 2 }; /* ticks over which a velocity may change: one command may be lost or overtaken */

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

/* Undo the stuffing in place, which never grows; the length, or 0 where it is damaged. */
static size_t unstuff(uint8_t *data, size_t count)
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

/* Frames are shorter than 254 bytes, so that each block ends at a zero. */
static size_t stuff(const uint8_t *data, size_t count, uint8_t *out)
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
    uint8_t wire[LARGEST + 2];
    put(payload + count, crc32(payload, count), CHECK);
    write(wire, stuff(payload, count + CHECK, wire));
}

static void rest(sc_device *device, sc_state state)
{
    device->state = state;
    memset(device->target, 0, sizeof device->target);
}

static int newer(uint16_t sequence, uint16_t last)
{
    uint16_t ahead = (uint16_t)(sequence - last);
    return ahead > 0 && ahead < 0x8000u;
}

static int follows(const sc_device *device)
{
    return device->state == SC_MOVING || device->state == SC_CLAMPED;
}

static int obeys(const sc_device *device)
{
    return device->state == SC_IDLE || follows(device);
}

/* At most `speed`, and at most `change` from what it was. */
static float within(double wanted, double was, double speed, double change)
{
    double slow = fmin(fmax(wanted, -speed), speed);
    return (float)fmin(fmax(slow, was - change), was + change);
}

static void follow(sc_device *device, uint16_t sequence, const uint8_t *body, uint32_t now_us)
{
    if (!obeys(device) || !newer(sequence, device->last))
        return;
    uint32_t elapsed = follows(device) ? now_us - device->heard_us : 0;
    uint32_t least = (uint32_t)BEFORE * device->tick_us;
    double span = (double)(elapsed > least ? elapsed : least) * 1e-6;
    device->state = device->state == SC_CLAMPED ? SC_CLAMPED : SC_MOVING;
    for (size_t j = 0; j < SC_JOINTS; j++) {
        float wanted = get_float(body + 4 * j);
        float was = device->target[j];
        device->target[j] = within(wanted, was, device->speed[j], device->acceleration[j] * span);
        if (device->target[j] < wanted || device->target[j] > wanted)
            device->state = SC_CLAMPED;
    }
    device->last = sequence;
    device->heard_us = now_us;
}

static void bound(sc_device *device, const uint8_t *body)
{
    uint16_t patience = (uint16_t)get(body + 8 * SC_JOINTS + 2, 2);
    for (size_t j = 0; j < 2 * SC_JOINTS; j++)
        if (get_float(body + 4 * j) < 0)
            return;
    if (device->state != SC_IDLE || patience == 0)
        return;
    for (size_t j = 0; j < SC_JOINTS; j++) {
        device->speed[j] = get_float(body + 4 * j);
        device->acceleration[j] = get_float(body + 4 * (SC_JOINTS + j));
    }
    device->tick_us = (uint16_t)get(body + 8 * SC_JOINTS, 2);
    device->patience_ms = patience < device->watchdog_ms ? patience : device->watchdog_ms;
}

static void unbound(sc_device *device)
{
    memset(device->speed, 0, sizeof device->speed);
    memset(device->acceleration, 0, sizeof device->acceleration);
    device->tick_us = 0;
    device->patience_ms = 0;
}

static void stop(sc_device *device, uint16_t sequence)
{
    if (!obeys(device))
        return;
    if (newer(sequence, device->last))
        device->last = sequence;
    rest(device, SC_IDLE);
}

static void greeted(sc_device *device, uint16_t sequence, uint8_t version)
{
    if (device->state == SC_LATCHED || version != SC_VERSION)
        return;
    device->last = sequence;
    unbound(device);
    rest(device, SC_IDLE);
}

static void act(sc_device *device, uint8_t kind, uint16_t sequence, const uint8_t *body, uint32_t now_us)
{
    switch (kind) {
    case VELOCITY: follow(device, sequence, body, now_us); break;
    case STOP: stop(device, sequence); break;
    case LATCH: rest(device, SC_LATCHED); break;
    case HELLO: greeted(device, sequence, body[0]); break;
    case LIMITS: bound(device, body); break;
    case CLEAR:
        if (device->state == SC_LATCHED)
            rest(device, SC_FRESH);
        break;
    default: break; /* PING */
    }
}

static void answer(const sc_device *device, uint16_t sequence, uint32_t now_us, const float *angles, sc_write write)
{
    uint8_t payload[LARGEST] = {ANSWER};
    put(payload + 1, sequence, 2);
    put(payload + HEAD, now_us, 4);
    payload[HEAD + 4] = (uint8_t)device->state;
    for (size_t j = 0; j < SC_JOINTS; j++)
        put_float(payload + HEAD + 5 + 4 * j, angles[j]);
    send(payload, HEAD + 5 + 4 * SC_JOINTS, write);
}

static void greet(const sc_device *device, uint16_t sequence, sc_write write)
{
    uint8_t payload[LARGEST] = {GREETING};
    put(payload + 1, sequence, 2);
    payload[HEAD] = SC_VERSION;
    payload[HEAD + 1] = SC_JOINTS;
    put(payload + HEAD + 2, device->watchdog_ms, 2);
    payload[HEAD + 4] = (uint8_t)device->state;
    send(payload, HEAD + 5, write);
}

static void tell_limits(const sc_device *device, uint16_t sequence, sc_write write)
{
    uint8_t payload[LARGEST] = {LIMITED};
    put(payload + 1, sequence, 2);
    for (size_t j = 0; j < SC_JOINTS; j++) {
        put_float(payload + HEAD + 4 * j, device->speed[j]);
        put_float(payload + HEAD + 4 * (SC_JOINTS + j), device->acceleration[j]);
    }
    put(payload + HEAD + 8 * SC_JOINTS, device->tick_us, 2);
    put(payload + HEAD + 8 * SC_JOINTS + 2, device->patience_ms, 2);
    send(payload, HEAD + BOUNDS, write);
}

/* Whether a payload without its checksum is a command of the right length, with numbers that are some. */
static int whole(const uint8_t *payload, size_t count)
{
    uint8_t kind = payload[0];
    size_t floats = kind == VELOCITY ? SC_JOINTS : kind == LIMITS ? 2 * SC_JOINTS : 0;
    size_t more = kind == LIMITS ? 4 : kind == HELLO ? 1 : 0;
    if (kind < PING || kind > LIMITS || count != HEAD + 4 * floats + more)
        return 0;
    for (size_t j = 0; j < floats; j++)
        if (!isfinite(get_float(payload + HEAD + 4 * j)))
            return 0;
    return 1;
}

static void obey(sc_device *device, uint32_t now_us, const float *angles, sc_write write)
{
    size_t count = unstuff(device->frame, device->length);
    if (count < HEAD + CHECK)
        return;
    count -= CHECK;
    const uint8_t *payload = device->frame;
    if (get(payload + count, CHECK) != crc32(payload, count) || !whole(payload, count))
        return;
    uint16_t sequence = (uint16_t)get(payload + 1, 2);
    act(device, payload[0], sequence, payload + HEAD, now_us);
    if (payload[0] == HELLO)
        greet(device, sequence, write);
    else if (payload[0] == LIMITS)
        tell_limits(device, sequence, write);
    else
        answer(device, sequence, now_us, angles, write);
}

void sc_init(sc_device *device, uint16_t watchdog_ms)
{
    memset(device, 0, sizeof *device);
    device->watchdog_ms = watchdog_ms;
    rest(device, SC_FRESH);
}

void sc_tick(sc_device *device, uint32_t now_us)
{
    uint32_t patience = device->patience_ms ? device->patience_ms : device->watchdog_ms;
    if (follows(device) && now_us - device->heard_us > 1000u * patience)
        rest(device, SC_TRIPPED);
}

void sc_receive(sc_device *device, uint8_t byte, uint32_t now_us, const float angles[SC_JOINTS], sc_write write)
{
    if (byte != 0) {
        if (device->length < SC_LONGEST)
            device->frame[device->length] = byte;
        if (device->length <= SC_LONGEST)
            device->length++;
        return;
    }
    if (device->length <= SC_LONGEST)
        obey(device, now_us, angles, write);
    device->length = 0;
}
