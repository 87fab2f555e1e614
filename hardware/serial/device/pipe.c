/* For tests: the device on standard input and output. The clock advances 1 ms per delimiter; joints rest. */
#include <stdio.h>

#include "stringcast.h"

static void write_out(const uint8_t *bytes, size_t count) { fwrite(bytes, 1, count, stdout); }

int main(void)
{
    const float angles[SC_JOINTS] = {0.5f, 0.25f, -1.0f};
    uint32_t now_us = 0;
    sc_device device;
    int byte;

    sc_init(&device, 25);
    while ((byte = getchar()) != EOF) {
        sc_tick(&device, now_us);
        sc_receive(&device, (uint8_t)byte, now_us, angles, write_out);
        now_us += byte == 0 ? 1000 : 0;
    }
    return 0;
}
