/* For tests: the device on a pseudo-terminal, whose name is printed. Joints follow the target at once.
 * usage: posix WATCHDOG_MS SECONDS */
#define _XOPEN_SOURCE 600
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "stringcast.h"

static int terminal;

static void write_out(const uint8_t *bytes, size_t count)
{
    if (write(terminal, bytes, count) < 0)
        perror("write");
}

static uint32_t micros(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)((uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u);
}

static int open_terminal(void)
{
    struct termios raw;
    int slave;
    terminal = posix_openpt(O_RDWR | O_NOCTTY);
    if (terminal < 0 || grantpt(terminal) || unlockpt(terminal) || (slave = open(ptsname(terminal), O_RDWR)) < 0)
        return -1;
    tcgetattr(slave, &raw); /* kept open, so that hosts may reconnect */
    raw.c_iflag &= ~(tcflag_t)(IGNBRK | BRKINT | PARMRK | ISTRIP | INLCR | IGNCR | ICRNL | IXON);
    raw.c_oflag &= ~(tcflag_t)OPOST;
    raw.c_lflag &= ~(tcflag_t)(ECHO | ECHONL | ICANON | ISIG | IEXTEN);
    tcsetattr(slave, TCSANOW, &raw);
    puts(ptsname(terminal));
    fflush(stdout);
    return 0;
}

static void listen_once(sc_device *device, const float *angles)
{
    uint8_t bytes[256];
    struct pollfd waiting = {terminal, POLLIN, 0};
    if (poll(&waiting, 1, 1) <= 0)
        return;
    ssize_t count = read(terminal, bytes, sizeof bytes);
    for (ssize_t i = 0; i < count; i++)
        sc_receive(device, bytes[i], micros(), angles, write_out);
}

int main(int count, char **words)
{
    float angles[SC_JOINTS] = {0};
    sc_device device;
    if (count != 3 || open_terminal())
        return 1;
    sc_init(&device, (uint16_t)atoi(words[1]));
    const uint32_t begun = micros();
    for (uint32_t last = begun, now; (now = micros()) - begun < 1e6 * atof(words[2]); last = now) {
        for (int j = 0; j < SC_JOINTS; j++)
            angles[j] += device.target[j] * (float)(now - last) * 1e-6f;
        sc_tick(&device, now);
        listen_once(&device, angles);
    }
    return 0;
}
