/* All clocks of a process and of its children run slower by a factor: see slow_clock.py.
 *
 * Loaded before the C library (LD_PRELOAD), it answers readings of the system clock and of the steady ones, and
 * stretches every wait. A slow reading is origin + (reading - origin) / factor; the origins are the same in all
 * processes, so their clocks agree. Clocks of CPU time stay as they are. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdlib.h>
#include <sys/epoll.h>
#include <sys/select.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

#define SECOND 1000000000LL
#define SYSTEM_EPOCH 1000000000LL /* s: deadlines above are of the system clock, those below of a steady one */

/* The function of the C library behind one of the same name here. */
#define NEXT(type, name, arguments)                                                                                    \
    static type(*next) arguments = NULL;                                                                               \
    if (next == NULL) next = (type(*) arguments)dlsym(RTLD_NEXT, #name)

static long long factor, system_origin, steady_origin; /* ns */

__attribute__((constructor)) static void read_environment(void) {
    const char *text = getenv("SLOW_CLOCK"); /* factor in thousandths, origins in ns */
    char *end;
    if (factor != 0 || text == NULL) return;
    long long thousandths = strtoll(text, &end, 10);
    system_origin = strtoll(end, &end, 10);
    steady_origin = strtoll(end, &end, 10);
    factor = thousandths;
}

static long long origin_of(clockid_t clock) {
    switch (clock) {
        case CLOCK_REALTIME: case CLOCK_REALTIME_COARSE: case CLOCK_TAI: return system_origin;
        case CLOCK_MONOTONIC: case CLOCK_MONOTONIC_COARSE: case CLOCK_MONOTONIC_RAW: case CLOCK_BOOTTIME:
            return steady_origin;
        default: return -1; /* CPU time */
    }
}

static long long to_ns(const struct timespec *t) { return t->tv_sec * SECOND + t->tv_nsec; }

static struct timespec from_ns(long long ns) {
    struct timespec t = {ns / SECOND, ns % SECOND};
    return t;
}

static long long slowed(long long reading, long long origin) {
    return origin + (long long)((__int128)(reading - origin) * 1000 / factor);
}

static struct timespec stretched(const struct timespec *wait) {
    return from_ns((long long)((__int128)to_ns(wait) * factor / 1000));
}

/* The instant of the true clock at which a slow one reads `deadline`. */
static struct timespec true_deadline(const struct timespec *deadline) {
    long long origin = deadline->tv_sec > SYSTEM_EPOCH ? system_origin : steady_origin;
    long long ns = origin + (long long)((__int128)(to_ns(deadline) - origin) * factor / 1000);
    return from_ns(ns > 0 ? ns : 0);
}

static int is_set(const struct timespec *t) { return t->tv_sec != 0 || t->tv_nsec != 0; }

/* Readings. */

int clock_gettime(clockid_t clock, struct timespec *t) {
    NEXT(int, clock_gettime, (clockid_t, struct timespec *));
    int result = next(clock, t);
    read_environment(); /* other libraries may read a clock before this one is initialised */
    long long origin = origin_of(clock);
    if (result == 0 && factor && origin >= 0) *t = from_ns(slowed(to_ns(t), origin));
    return result;
}

int gettimeofday(struct timeval *restrict t, void *restrict zone) {
    struct timespec now;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &now);
    t->tv_sec = now.tv_sec;
    t->tv_usec = now.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *out) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (out != NULL) *out = now.tv_sec;
    return now.tv_sec;
}

/* Sleeps. */

int clock_nanosleep(clockid_t clock, int flags, const struct timespec *wait, struct timespec *left) {
    NEXT(int, clock_nanosleep, (clockid_t, int, const struct timespec *, struct timespec *));
    struct timespec t = (flags & TIMER_ABSTIME) ? true_deadline(wait) : stretched(wait);
    int result = next(clock, flags, &t, left);
    if (result == EINTR && left != NULL && !(flags & TIMER_ABSTIME))
        *left = from_ns((long long)((__int128)to_ns(left) * 1000 / factor));
    return result;
}

int nanosleep(const struct timespec *wait, struct timespec *left) {
    int error = clock_nanosleep(CLOCK_MONOTONIC, 0, wait, left);
    if (error == 0) return 0;
    errno = error;
    return -1;
}

int usleep(useconds_t microseconds) {
    struct timespec wait = from_ns(1000LL * microseconds);
    return nanosleep(&wait, NULL);
}

unsigned sleep(unsigned seconds) {
    struct timespec wait = {seconds, 0}, left = {0, 0};
    return nanosleep(&wait, &left) == 0 ? 0 : (unsigned)left.tv_sec;
}

/* Waits until an instant, for locks. */

#define TIMED(name, object)                                                                                            \
    int name(object *waited_for, const struct timespec *deadline) {                                                    \
        NEXT(int, name, (object *, const struct timespec *));                                                          \
        struct timespec t = true_deadline(deadline);                                                                   \
        return next(waited_for, &t);                                                                                   \
    }
#define CLOCKED(name, object)                                                                                          \
    int name(object *waited_for, clockid_t clock, const struct timespec *deadline) {                                   \
        NEXT(int, name, (object *, clockid_t, const struct timespec *));                                               \
        struct timespec t = true_deadline(deadline);                                                                   \
        return next(waited_for, clock, &t);                                                                            \
    }
TIMED(sem_timedwait, sem_t)
CLOCKED(sem_clockwait, sem_t)
TIMED(pthread_mutex_timedlock, pthread_mutex_t)
CLOCKED(pthread_mutex_clocklock, pthread_mutex_t)
TIMED(pthread_rwlock_timedrdlock, pthread_rwlock_t)
CLOCKED(pthread_rwlock_clockrdlock, pthread_rwlock_t)
TIMED(pthread_rwlock_timedwrlock, pthread_rwlock_t)
CLOCKED(pthread_rwlock_clockwrlock, pthread_rwlock_t)

int pthread_cond_timedwait(pthread_cond_t *condition, pthread_mutex_t *mutex, const struct timespec *deadline) {
    NEXT(int, pthread_cond_timedwait, (pthread_cond_t *, pthread_mutex_t *, const struct timespec *));
    struct timespec t = true_deadline(deadline);
    return next(condition, mutex, &t);
}

int pthread_cond_clockwait(
    pthread_cond_t *condition, pthread_mutex_t *mutex, clockid_t clock, const struct timespec *deadline) {
    NEXT(int, pthread_cond_clockwait, (pthread_cond_t *, pthread_mutex_t *, clockid_t, const struct timespec *));
    struct timespec t = true_deadline(deadline);
    return next(condition, mutex, clock, &t);
}

/* Waits of a length, for files. */

static int stretched_ms(int ms) { return ms > 0 ? (int)((ms * factor + 999) / 1000) : ms; }

int poll(struct pollfd *files, nfds_t count, int ms) {
    NEXT(int, poll, (struct pollfd *, nfds_t, int));
    return next(files, count, stretched_ms(ms));
}

int ppoll(struct pollfd *files, nfds_t count, const struct timespec *wait, const sigset_t *mask) {
    NEXT(int, ppoll, (struct pollfd *, nfds_t, const struct timespec *, const sigset_t *));
    struct timespec t = wait ? stretched(wait) : (struct timespec){0, 0};
    return next(files, count, wait ? &t : NULL, mask);
}

int epoll_wait(int epoll, struct epoll_event *events, int count, int ms) {
    NEXT(int, epoll_wait, (int, struct epoll_event *, int, int));
    return next(epoll, events, count, stretched_ms(ms));
}

int epoll_pwait(int epoll, struct epoll_event *events, int count, int ms, const sigset_t *mask) {
    NEXT(int, epoll_pwait, (int, struct epoll_event *, int, int, const sigset_t *));
    return next(epoll, events, count, stretched_ms(ms), mask);
}

int pselect(int count, fd_set *in, fd_set *out, fd_set *other, const struct timespec *wait, const sigset_t *mask) {
    NEXT(int, pselect, (int, fd_set *, fd_set *, fd_set *, const struct timespec *, const sigset_t *));
    struct timespec t = wait ? stretched(wait) : (struct timespec){0, 0};
    return next(count, in, out, other, wait ? &t : NULL, mask);
}

int select(int count, fd_set *in, fd_set *out, fd_set *other, struct timeval *wait) {
    struct timespec t = wait ? (struct timespec){wait->tv_sec, wait->tv_usec * 1000L} : (struct timespec){0, 0};
    return pselect(count, in, out, other, wait ? &t : NULL, NULL);
}

int timerfd_settime(int file, int flags, const struct itimerspec *timer, struct itimerspec *before) {
    NEXT(int, timerfd_settime, (int, int, const struct itimerspec *, struct itimerspec *));
    struct itimerspec t = {stretched(&timer->it_interval), stretched(&timer->it_value)};
    if ((flags & TFD_TIMER_ABSTIME) && is_set(&timer->it_value)) t.it_value = true_deadline(&timer->it_value);
    return next(file, flags, &t, before);
}
