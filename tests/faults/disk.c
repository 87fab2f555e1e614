/* Preloaded into a process and those it starts, this lets the n-th operation that writes below a folder fail.

   FAULT_BELOW: the folder, absolute. FAULT_AT: n, from 0. FAULT_ERROR: errno. FAULT_LASTS: not empty: so do all after
   it. FAULT_COUNT: a file of 4096 bytes that all processes share: how many there were [8 bytes], then the name of the
   one that failed first. A failing write gets half done. Removing always works on a full disk. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

static long *count; /* shared */

static int below(const char *path)
{
    const char *folder = getenv("FAULT_BELOW");
    char whole[PATH_MAX];
    if (!folder || !path)
        return 0;
    if (path[0] != '/') {
        char here[PATH_MAX];
        if (!getcwd(here, sizeof here) || snprintf(whole, sizeof whole, "%s/%s", here, path) >= (int)sizeof whole)
            return 0;
        path = whole;
    }
    size_t length = strlen(folder);
    return !strncmp(path, folder, length) && (!path[length] || path[length] == '/');
}

/* Whether a file that is open lies below; path: its name. */
static int open_below(int handle, char path[PATH_MAX])
{
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", handle);
    ssize_t length = readlink(link, path, PATH_MAX - 1);
    if (length < 0)
        return 0;
    path[length] = 0;
    return below(path);
}

static int share(void)
{
    int (*real_open)(const char *, int, ...) = dlsym(RTLD_NEXT, "open");
    int handle = count ? -1 : real_open(getenv("FAULT_COUNT"), O_RDWR | O_CLOEXEC);
    if (handle >= 0) {
        count = mmap(NULL, 4096, PROT_READ | PROT_WRITE, MAP_SHARED, handle, 0);
        close(handle);
    }
    return count != NULL;
}

/* Count an operation; whether it is to fail, with errno set. */
static int fails(const char *name, const char *path)
{
    if (!getenv("FAULT_COUNT") || !share())
        return 0;
    long at = __sync_fetch_and_add(count, 1), n = atol(getenv("FAULT_AT"));
    if (at < n || (at > n && !*getenv("FAULT_LASTS")))
        return 0;
    if (at == n)
        snprintf((char *)(count + 1), 4096 - sizeof(long), "%s %s", name, path);
    errno = atoi(getenv("FAULT_ERROR"));
    return 1;
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define WRITES(flags) ((flags) & (O_WRONLY | O_RDWR | O_CREAT | O_TRUNC | O_APPEND))
#define OPENING(name)                                                    \
    int name(const char *path, int flags, ...)                           \
    {                                                                    \
        va_list rest;                                                    \
        va_start(rest, flags);                                           \
        mode_t mode = flags & O_CREAT ? va_arg(rest, mode_t) : 0;        \
        va_end(rest);                                                    \
        if (WRITES(flags) && below(path) && fails("open", path))         \
            return -1;                                                   \
        return REAL(name)(path, flags, mode);                            \
    }
OPENING(open)
OPENING(open64)

ssize_t write(int handle, const void *bytes, size_t size)
{
    char path[PATH_MAX];
    if (open_below(handle, path) && fails("write", path)) {
        int error = errno;
        (void)!REAL(write)(handle, bytes, size / 2);
        errno = error;
        return -1;
    }
    return REAL(write)(handle, bytes, size);
}

int fsync(int handle)
{
    char path[PATH_MAX];
    return open_below(handle, path) && fails("fsync", path) ? -1 : 0; /* no power cut is asked for: no waiting for the disk */
}

int mkdir(const char *path, mode_t mode)
{
    return below(path) && access(path, F_OK) && fails("mkdir", path) ? -1 : REAL(mkdir)(path, mode);
}

int rename(const char *from, const char *to)
{
    return below(to) && fails("rename", to) ? -1 : REAL(rename)(from, to);
}

int unlink(const char *path)
{
    return below(path) && atoi(getenv("FAULT_ERROR")) != ENOSPC && fails("unlink", path) ? -1 : REAL(unlink)(path);
}
