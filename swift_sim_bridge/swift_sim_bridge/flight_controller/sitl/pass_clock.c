// The clock of a firmware with gyro sync, in its passes instead of the wall's time: loaded before the program's own
// libraries (LD_PRELOAD), it answers for clock_gettime. From the first packet of state on, each packet lets time go on
// by one pass; until the next one it stands. So what the firmware times, frames of sticks above all, is the same in
// every life, however busy the machine. Without packets for IDLE_NS (while it starts, or restarts) it is the wall's.
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

enum { STATE_BYTES = 144, LOOK_NS = 400, NAP_NS = 20000, SHORT_NAP_NS = 50000, PATIENCE = 100000 };
static const int64_t SECOND_NS = 1000000000, IDLE_NS = 2000000000, PASS_NS = 125000;

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static int64_t now_ns, until_ns, wall_ns, packet_ns;  // until: how far the packets so far let time go
static int begun, counting;
static atomic_int msp_socket = -1, msp_busy = 0;  // frames of sticks come by MSP, read by a thread of its own
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

int clock_gettime(clockid_t clock, struct timespec *told) {
    static __thread int looks;
    if (clock != CLOCK_MONOTONIC) return syscall(SYS_clock_gettime, clock, told);
    pthread_mutex_lock(&lock);
    int64_t t = wall();
    if (!begun) begun = 1, now_ns = wall_ns = t;
    if (counting && t - packet_ns > IDLE_NS) counting = 0;
    if (!counting) now_ns += t - wall_ns;
    else if ((now_ns += LOOK_NS) > until_ns) now_ns = until_ns;  // a loop that waits for a time must see some pass
    wall_ns = t;
    int stands = counting && now_ns >= until_ns;
    told->tv_sec = now_ns / SECOND_NS, told->tv_nsec = now_ns % SECOND_NS;
    pthread_mutex_unlock(&lock);
    if (!stands) looks = 0;
    else if (++looks > 30) nap();
    return 0;
}

// Time goes on when all sticks that were sent before the packet have been read: else it would be chance when they are.
static void go_on(void) {
    for (int i = 0; i < PATIENCE; i++) {
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
    static ssize_t (*plain)(int, void *, size_t, int, struct sockaddr *, socklen_t *);
    if (!plain) plain = dlsym(RTLD_NEXT, "recvfrom");
    ssize_t count = plain(socket, bytes, room, flags, from, size);
    if (count == STATE_BYTES) packet_came = 1;
    return count;
}

ssize_t recv(int socket, void *bytes, size_t room, int flags) {
    static ssize_t (*plain)(int, void *, size_t, int);
    if (!plain) plain = dlsym(RTLD_NEXT, "recv");
    ssize_t count = plain(socket, bytes, room, flags);
    if (count > 0) {
        reads_msp = 1;
        msp_busy = 1;
        msp_socket = socket;
    } else if (count == 0 && socket == msp_socket) {
        msp_socket = -1;
    }
    return count;
}

int select(int count, fd_set *in, fd_set *out, fd_set *other, struct timeval *most) {  // a thread is done with a packet
    static int (*plain)(int, fd_set *, fd_set *, fd_set *, struct timeval *);
    if (!plain) plain = dlsym(RTLD_NEXT, "select");
    if (reads_msp) msp_busy = 0;
    if (packet_came) packet_came = 0, go_on();
    return plain(count, in, out, other, most);
}

int nanosleep(const struct timespec *asked, struct timespec *left) {
    pthread_mutex_lock(&lock);
    int skips = counting && asked->tv_sec == 0 && asked->tv_nsec <= SHORT_NAP_NS;
    pthread_mutex_unlock(&lock);
    return skips ? 0 : syscall(SYS_nanosleep, asked, left);
}
