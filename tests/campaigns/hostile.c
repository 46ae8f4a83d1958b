/* Preloaded: a process dies at one chosen system call, or has its disk fail from there on; its wall
   clock is off by the seconds (64-bit integers, of which WYNER_CLOCK_PLACE picks one) in the file
   that WYNER_CLOCK names; and a folder is read-only, under open files too, while the file that
   WYNER_DISK names says so: a byte that is not 0, and from byte 8 on the folder's path.

   WYNER_DEATH=CALL:FILE:N:HOW, where CALL is a function below, FILE a part of the path (or
   "socket"), N counts matching calls from 1, and HOW is
     before, after   SIGKILL there
     tear            SIGKILL once half of the bytes are written
     a number        this call and all later ones fail with that errno
*/
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

static atomic_int calls;

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

/* The page of a file that others write to; none where the variable names none. */
static const volatile char *page_of(const char *variable) {
    const char *path = getenv(variable);
    if (!path) return 0;
    int fd = REAL(open)(path, O_RDONLY);
    void *page = mmap(0, 4096, PROT_READ, MAP_SHARED, fd, 0);
    close(fd);
    return page == MAP_FAILED ? 0 : page;
}

static void die(void) {
    kill(getpid(), SIGKILL);
    for (;;) pause();
}

/* Whether the file is in the folder that is read-only now. */
static int read_only(int fd, const char *path) {
    static _Atomic(const volatile char *) disk;
    if (!disk) disk = page_of("WYNER_DISK");
    if (!disk || !*disk) return 0;
    char link[64], target[4096];
    if (!path) {
        snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
        ssize_t size = readlink(link, target, sizeof target - 1);
        if (size < 0) return 0;
        target[size] = 0;
        path = target;
    }
    const char *folder = (const char *)disk + 8;
    return !strncmp(path, folder, strlen(folder));
}

/* What is to happen at this call: 0 nothing, -1 death before, -2 after, -3 torn, else an errno. */
static int fate(const char *call, int fd, const char *path) {
    if (read_only(fd, path)) return EROFS;
    const char *spec = getenv("WYNER_DEATH");
    char kind[32], part[64], how[16], link[64], target[4096];
    int n;
    if (!spec || sscanf(spec, "%31[^:]:%63[^:]:%d:%15s", kind, part, &n, how) != 4) return 0;
    if (strcmp(kind, call)) return 0;
    if (!path) {
        snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
        ssize_t size = readlink(link, target, sizeof target - 1);
        if (size < 0) return 0;
        target[size] = 0;
        path = target;
    }
    if (!strstr(path, part)) return 0;
    int now = atomic_fetch_add(&calls, 1) + 1;
    if (atoi(how)) return now >= n ? atoi(how) : 0;
    if (now != n) return 0;
    return !strcmp(how, "before") ? -1 : !strcmp(how, "after") ? -2 : -3;
}

#define AROUND(type, call, fd, path, torn, ...)                     \
    int what = fate(#call, fd, path);                               \
    if (what > 0) { errno = what; return -1; }                      \
    if (what == -1) die();                                          \
    if (what == -3) { torn; die(); }                                \
    type result = REAL(call)(__VA_ARGS__);                          \
    if (what == -2) die();                                          \
    return result

ssize_t write(int fd, const void *data, size_t size) {
    AROUND(ssize_t, write, fd, 0, REAL(write)(fd, data, size / 2), fd, data, size);
}
ssize_t pwrite64(int fd, const void *data, size_t size, off64_t at) {
    AROUND(ssize_t, pwrite64, fd, 0, REAL(pwrite64)(fd, data, size / 2, at), fd, data, size, at);
}
ssize_t writev(int fd, const struct iovec *parts, int count) {
    AROUND(ssize_t, writev, fd, 0, REAL(writev)(fd, parts, count / 2), fd, parts, count);
}
ssize_t send(int fd, const void *data, size_t size, int flags) {
    AROUND(ssize_t, send, fd, 0, REAL(send)(fd, data, size / 2, flags), fd, data, size, flags);
}
int fsync(int fd) { AROUND(int, fsync, fd, 0, , fd); }
int fdatasync(int fd) { AROUND(int, fdatasync, fd, 0, , fd); }
int ftruncate64(int fd, off64_t size) { AROUND(int, ftruncate64, fd, 0, , fd, size); }
int unlink(const char *path) { AROUND(int, unlink, -1, path, , path); }
int rename(const char *from, const char *to) { AROUND(int, rename, -1, to, , from, to); }

int mkdir(const char *path, mode_t mode) { AROUND(int, mkdir, -1, path, , path, mode); }
int renameat2(int near, const char *from, int far, const char *to, unsigned flags) {
    AROUND(int, renameat2, -1, to, , near, from, far, to, flags);
}

#define WRITES(flags) ((flags) & (O_WRONLY | O_RDWR | O_CREAT | O_TRUNC))
#define OPENS(name, ...)                                                          \
    va_list more;                                                                 \
    va_start(more, flags);                                                        \
    mode_t mode = flags & O_CREAT ? va_arg(more, mode_t) : 0;                     \
    va_end(more);                                                                 \
    if (WRITES(flags) && read_only(-1, path)) { errno = EROFS; return -1; }       \
    return REAL(name)(__VA_ARGS__, mode)
int open(const char *path, int flags, ...) { OPENS(open, path, flags); }
int open64(const char *path, int flags, ...) { OPENS(open64, path, flags); }
int openat(int at, const char *path, int flags, ...) { OPENS(openat, at, path, flags); }
int openat64(int at, const char *path, int flags, ...) { OPENS(openat64, at, path, flags); }

static long off(void) {
    static _Atomic(const volatile char *) clocks;
    if (!clocks) clocks = page_of("WYNER_CLOCK");
    const char *place = getenv("WYNER_CLOCK_PLACE");
    return clocks ? ((const volatile long *)clocks)[place ? atoi(place) : 0] : 0;
}
int clock_gettime(clockid_t clock, struct timespec *now) {
    static _Atomic(__typeof__(&clock_gettime)) real;
    if (!real) real = REAL(clock_gettime);
    int result = real(clock, now);
    if (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE) now->tv_sec += off();
    return result;
}
time_t time(time_t *now) {
    struct timespec read;
    clock_gettime(CLOCK_REALTIME, &read);
    if (now) *now = read.tv_sec;
    return read.tv_sec;
}
