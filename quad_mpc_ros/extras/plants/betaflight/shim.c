// Copyright 2026 quad_mpc_ros contributors
// SPDX-License-Identifier: Apache-2.0
/* Preloaded into Betaflight's simulator target: gives it time and packets of a simulation.
 *
 * Time passes for the main loop only while it has been granted: a little whenever it sleeps or
 * looks at the clock, so that it never waits. When a grant is used up, the motors go out over the
 * link and the next grant comes in, with what the sensors shall be and with how much must have
 * come over TCP; the threads that take that have taken it before the main loop goes on, and work
 * only while it stands still. So a flight is the same each time, at any speed.
 *
 * Of the firmware it knows the ports that are published for simulators: motors to 9001, state from
 * 9003, receiver from 9004, UART1 on TCP 5761, which becomes any that is free.
 */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <dlfcn.h>
#include <errno.h>
#include <netinet/in.h>
#include <pthread.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum { PORT_MOTORS = 9001, PORT_STATE = 9003, PORT_RECEIVER = 9004, PORT_UART1 = 5761 };

/* How much time passes: at a look at the clock, and at most at a sleep. The main loop sleeps after
 * every pass, to spare a processor, and would overshoot the times of its rate loop. */
enum { LOOK_NS = 100, PASS_NS = 10000 };

enum { TCP_WAIT_US = 500 };

typedef struct {
    int64_t grant_ns;       /* how long the main loop may go on */
    uint32_t taken;         /* bytes that must have come over TCP before */
    uint16_t state_size;    /* of the packets that follow; 0 is none */
    uint16_t receiver_size;
} request_t;

typedef struct {
    int64_t now_ns;
    float motors[4];        /* pulse widths [us] in the firmware's order */
    uint32_t port;          /* of UART1, 0 before it is open */
    uint32_t unused;
} answer_t;

typedef struct {
    int fd;
    int full, busy; /* a packet waits; its thread works on one */
    size_t size;
    char data[512];
} inbox_t;

static pthread_t main_thread;
static int link_fd = -1;
static int64_t now_ns = 1000000000, until_ns;
static float motors[4];
static uint32_t uart1_port;

/* Held by whom may work: the main loop, or the thread of TCP. */
static pthread_mutex_t turn = PTHREAD_MUTEX_INITIALIZER;

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t changed = PTHREAD_COND_INITIALIZER;
static inbox_t state = {.fd = -1}, receiver = {.fd = -1};
static uint32_t tcp_read, tcp_taken;
static int threads_waiting;
static __thread int has_turn, has_waited;

static int (*real_bind)(int, const struct sockaddr *, socklen_t);
static int (*real_select)(int, fd_set *, fd_set *, fd_set *, struct timeval *);
static ssize_t (*real_recvfrom)(int, void *, size_t, int, struct sockaddr *, socklen_t *);
static ssize_t (*real_recv)(int, void *, size_t, int);
static int (*real_create)(pthread_t *, const pthread_attr_t *, void *(*)(void *), void *);
static ssize_t (*real_sendto)(int, const void *, size_t, int, const struct sockaddr *, socklen_t);

__attribute__((constructor)) static void begin(void)
{
    real_bind = dlsym(RTLD_NEXT, "bind");
    real_select = dlsym(RTLD_NEXT, "select");
    real_recvfrom = dlsym(RTLD_NEXT, "recvfrom");
    real_recv = dlsym(RTLD_NEXT, "recv");
    real_sendto = dlsym(RTLD_NEXT, "sendto");
    real_create = dlsym(RTLD_NEXT, "pthread_create");
    const char *given = getenv("QUAD_MPC_ROS_LINK");
    if (given == NULL) _exit(1);
    link_fd = atoi(given);
    main_thread = pthread_self();
    pthread_mutex_lock(&turn);
    unsetenv("LD_PRELOAD");
    const char *boot = getenv("QUAD_MPC_ROS_BOOT_NS");
    until_ns = now_ns + (boot == NULL ? 0 : atoll(boot));
}

static int is_main(void)
{
    return pthread_equal(pthread_self(), main_thread);
}

/* The link. It ends the process when the other side is gone. */

static void put(const void *data, size_t size)
{
    for (const char *at = data; size > 0;) {
        const ssize_t done = send(link_fd, at, size, MSG_NOSIGNAL);
        if (done <= 0 && errno != EINTR) _exit(0);
        if (done > 0) at += done, size -= (size_t)done;
    }
}

static void get(void *data, size_t size)
{
    for (char *at = data; size > 0;) {
        const ssize_t done = read(link_fd, at, size);
        if (done == 0 || (done < 0 && errno != EINTR)) _exit(0);
        if (done > 0) at += done, size -= (size_t)done;
    }
}

static void hand_over(inbox_t *inbox, size_t size)
{
    if (size == 0) return;
    if (size > sizeof(inbox->data)) _exit(1);
    pthread_mutex_lock(&lock);
    get(inbox->data, size);
    inbox->size = size;
    inbox->full = 1;
    pthread_cond_broadcast(&changed);
    while (inbox->full || inbox->busy) pthread_cond_wait(&changed, &lock);
    pthread_mutex_unlock(&lock);
}

static void ask_for_time(void)
{
    pthread_mutex_unlock(&turn);
    while (now_ns >= until_ns) {
        request_t request;
        answer_t answer = {.now_ns = now_ns, .port = uart1_port};
        memcpy(answer.motors, motors, sizeof(motors));
        put(&answer, sizeof(answer));
        get(&request, sizeof(request));
        hand_over(&receiver, request.receiver_size);
        hand_over(&state, request.state_size);
        pthread_mutex_lock(&lock);
        while ((int32_t)(tcp_taken - request.taken) < 0) pthread_cond_wait(&changed, &lock);
        pthread_mutex_unlock(&lock);
        until_ns += request.grant_ns;
    }
    pthread_mutex_lock(&turn);
}

/* What the firmware calls. */

int clock_gettime(clockid_t clock, struct timespec *at)
{
    if (clock != CLOCK_MONOTONIC) return (int)syscall(SYS_clock_gettime, clock, at);
    if (is_main()) now_ns += LOOK_NS;
    at->tv_sec = now_ns / 1000000000;
    at->tv_nsec = now_ns % 1000000000;
    return 0;
}

int nanosleep(const struct timespec *wanted, struct timespec *left)
{
    if (!is_main()) return (int)syscall(SYS_nanosleep, wanted, left);
    const int64_t asked_ns = wanted->tv_sec * 1000000000 + wanted->tv_nsec;
    now_ns += asked_ns < PASS_NS ? asked_ns : PASS_NS;
    if (now_ns >= until_ns) ask_for_time();
    return 0;
}

int bind(int fd, const struct sockaddr *address, socklen_t size)
{
    if (address->sa_family != AF_INET) return real_bind(fd, address, size);
    struct sockaddr_in wanted = *(const struct sockaddr_in *)address;
    switch (ntohs(wanted.sin_port)) {
    case PORT_STATE:
        state.fd = fd;
        return 0;
    case PORT_RECEIVER:
        receiver.fd = fd;
        return 0;
    case PORT_UART1:
        wanted.sin_port = 0;
        wanted.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        if (real_bind(fd, (struct sockaddr *)&wanted, sizeof(wanted)) != 0) return -1;
        size = sizeof(wanted);
        getsockname(fd, (struct sockaddr *)&wanted, &size);
        uart1_port = ntohs(wanted.sin_port);
        return 0;
    default:
        return real_bind(fd, address, size);
    }
}

static int wait_for(inbox_t *inbox)
{
    pthread_mutex_lock(&lock);
    inbox->busy = 0;
    pthread_cond_broadcast(&changed);
    while (!inbox->full) pthread_cond_wait(&changed, &lock);
    pthread_mutex_unlock(&lock);
    return 1;
}

static int wait_for_tcp(int count, fd_set *in, fd_set *out, fd_set *bad, struct timeval *timeout)
{
    pthread_mutex_lock(&lock);
    tcp_taken = tcp_read;
    pthread_cond_broadcast(&changed);
    pthread_mutex_unlock(&lock);
    if (timeout != NULL && (timeout->tv_sec > 0 || timeout->tv_usec > TCP_WAIT_US)) {
        timeout->tv_sec = 0;
        timeout->tv_usec = TCP_WAIT_US;
    }
    if (has_turn) pthread_mutex_unlock(&turn);
    const int found = real_select(count, in, out, bad, timeout);
    pthread_mutex_lock(&turn);
    has_turn = 1;
    return found;
}

int select(int count, fd_set *in, fd_set *out, fd_set *bad, struct timeval *timeout)
{
    if (!has_waited) {
        has_waited = 1;
        pthread_mutex_lock(&lock);
        threads_waiting++;
        pthread_cond_broadcast(&changed);
        pthread_mutex_unlock(&lock);
    }
    if (state.fd >= 0 && state.fd < count && FD_ISSET(state.fd, in)) return wait_for(&state);
    if (receiver.fd >= 0 && receiver.fd < count && FD_ISSET(receiver.fd, in))
        return wait_for(&receiver);
    return wait_for_tcp(count, in, out, bad, timeout);
}

ssize_t recvfrom(int fd, void *data, size_t size, int flags, struct sockaddr *from, socklen_t *length)
{
    inbox_t *inbox = fd == state.fd ? &state : fd == receiver.fd ? &receiver : NULL;
    if (inbox == NULL) return real_recvfrom(fd, data, size, flags, from, length);
    pthread_mutex_lock(&lock);
    if (inbox->size < size) size = inbox->size;
    memcpy(data, inbox->data, size);
    inbox->full = 0;
    inbox->busy = 1;
    pthread_mutex_unlock(&lock);
    return (ssize_t)size;
}

ssize_t recv(int fd, void *data, size_t size, int flags)
{
    const ssize_t done = real_recv(fd, data, size, flags);
    if (done > 0) tcp_read += (uint32_t)done;
    return done;
}

ssize_t sendto(int fd, const void *data, size_t size, int flags, const struct sockaddr *to, socklen_t length)
{
    if (to == NULL || to->sa_family != AF_INET)
        return real_sendto(fd, data, size, flags, to, length);
    /* The number of motors comes first, in four bytes. */
    if (ntohs(((const struct sockaddr_in *)to)->sin_port) == PORT_MOTORS &&
        size >= 4 + sizeof(motors))
        memcpy(motors, (const char *)data + 4, sizeof(motors));
    return (ssize_t)size;
}

/* Each thread prepares itself and waits for the first time before the firmware goes on. */
int pthread_create(pthread_t *thread, const pthread_attr_t *how, void *(*run)(void *), void *with)
{
    static int threads;
    const int failed = real_create(thread, how, run, with);
    if (failed) return failed;
    threads++;
    pthread_mutex_lock(&lock);
    while (threads_waiting < threads) pthread_cond_wait(&changed, &lock);
    pthread_mutex_unlock(&lock);
    return 0;
}

/* The firmware joins its threads when it starts anew; those wait here, and what it saved is on
 * the disk. */
int pthread_join(pthread_t thread, void **result)
{
    (void)thread, (void)result;
    _exit(0);
}
