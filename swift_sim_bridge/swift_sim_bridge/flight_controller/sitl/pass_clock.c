// Clock that counts passes of the rate loop, for a firmware with gyro sync. Preloaded (LD_PRELOAD), it replaces
// clock_gettime. From the first state packet on, each packet advances time by one pass; then time stops until the next
// packet. What the firmware times, above all stick frames, is therefore the same in every run on a machine under any
// load. Without packets for IDLE_NS (while the firmware starts or restarts) it is the wall clock.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdint.h>
#include <sys/ioctl.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum {
    STATE_BYTES = 144,      // size of a state packet
    READING_NS = 400,       // time that passes with each reading of the clock
    NAP_NS = 20000,         // real sleep of a loop that waits for a stopped clock
    SHORT_NAP_NS = 50000,   // a sleep up to this long is skipped
    MAX_NAPS = 100000       // naps until unread stick frames are no longer waited for
};
static const int64_t SECOND_NS = 1000000000, IDLE_NS = 2000000000, PASS_NS = 125000;

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static int64_t now_ns, until_ns, wall_ns, packet_ns;  // until_ns: end of the passes received so far
static int begun, counting;
static atomic_int msp_socket = -1, msp_busy = 0;  // a thread of the firmware reads MSP
static __thread int reads_msp, packet_came;

static int64_t wall(void) {
    struct timespec t;
    syscall(SYS_clock_gettime, CLOCK_MONOTONIC, &t);
    return t.tv_sec * SECOND_NS + t.tv_nsec;
}

static void nap(void) {
    struct timespec t = {0, NAP_NS};
    syscall(SYS_nanosleep, &t, NULL);
}

int clock_gettime(clockid_t clock, struct timespec *result) {
    static __thread int readings;
    if (clock != CLOCK_MONOTONIC) return syscall(SYS_clock_gettime, clock, result);
    pthread_mutex_lock(&lock);
    int64_t t = wall();
    if (!begun) begun = 1, now_ns = wall_ns = t;
    if (counting && t - packet_ns > IDLE_NS) counting = 0;
    if (!counting) now_ns += t - wall_ns;
    else if ((now_ns += READING_NS) > until_ns) now_ns = until_ns;  // a loop that waits for a time must see time pass
    wall_ns = t;
    int stopped = counting && now_ns >= until_ns;
    result->tv_sec = now_ns / SECOND_NS, result->tv_nsec = now_ns % SECOND_NS;
    pthread_mutex_unlock(&lock);
    if (!stopped) readings = 0;
    else if (++readings > 30) nap();
    return 0;
}

// Advance time by one pass, after all stick frames sent before the packet were read: otherwise the pass in which they
// are read would be random.
static void advance(void) {
    for (int i = 0; i < MAX_NAPS; i++) {
        int unread = 0, socket = msp_socket;
        if (socket >= 0) ioctl(socket, FIONREAD, &unread);
        if (!unread && !msp_busy) break;
        nap();
    }
    pthread_mutex_lock(&lock);
    packet_ns = wall();
    if (!counting) counting = 1, until_ns = now_ns;
    until_ns += PASS_NS;
    pthread_mutex_unlock(&lock);
}

ssize_t recvfrom(int socket, void *bytes, size_t room, int flags, struct sockaddr *from, socklen_t *size) {
    static ssize_t (*original)(int, void *, size_t, int, struct sockaddr *, socklen_t *);
    if (!original) original = dlsym(RTLD_NEXT, "recvfrom");
    ssize_t count = original(socket, bytes, room, flags, from, size);
    if (count == STATE_BYTES) packet_came = 1;
    return count;
}

ssize_t recv(int socket, void *bytes, size_t room, int flags) {
    static ssize_t (*original)(int, void *, size_t, int);
    if (!original) original = dlsym(RTLD_NEXT, "recv");
    ssize_t count = original(socket, bytes, room, flags);
    if (count > 0) {
        reads_msp = 1;
        msp_busy = 1;
        msp_socket = socket;
    } else if (count == 0 && socket == msp_socket) {
        msp_socket = -1;
    }
    return count;
}

int select(int count, fd_set *in, fd_set *out, fd_set *other, struct timeval *most) {  // called when a thread has handled a packet
    static int (*original)(int, fd_set *, fd_set *, fd_set *, struct timeval *);
    if (!original) original = dlsym(RTLD_NEXT, "select");
    if (reads_msp) msp_busy = 0;
    if (packet_came) packet_came = 0, advance();
    return original(count, in, out, other, most);
}

int nanosleep(const struct timespec *asked, struct timespec *left) {
    pthread_mutex_lock(&lock);
    int skips = counting && asked->tv_sec == 0 && asked->tv_nsec <= SHORT_NAP_NS;
    pthread_mutex_unlock(&lock);
    return skips ? 0 : syscall(SYS_nanosleep, asked, left);
}
