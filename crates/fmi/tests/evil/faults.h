/* What ends or stops the process of a model: FAULT, where k is above FAULT_ABOVE and the time above 0.2; with FAULT_AT_END in fmi2Terminate. */
#include <signal.h>
#include <unistd.h>
#include <errno.h>
#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/wait.h>
#ifdef LEAKS
static void leak(void) {
    char *lost = malloc(LEAKS);
    size_t i;
    for (i = 0; lost != NULL && i < LEAKS; i += 4096) lost[i] = 1;
}
#endif
#ifdef FAULT
static double overflow(double depth) {
    volatile double large[4096];
    large[0] = depth;
    return overflow(depth + 1) + large[0];
}
static void hang(void) {
    for (;;) pause();
}
static void close_all(void) {
    int i;
    for (i = 0; i < 256; i++) close(i);
}
static void fill_memory(void) {
    size_t size = (size_t)1 << 30;
    for (;;) memset(malloc(size), 1, size);
}
static void fill_shared_memory(void) {
    size_t size = (size_t)1 << 26;
    for (;;) {
        void *shared = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
        if (shared == MAP_FAILED) exit(5);
        memset(shared, 1, size);
    }
}
/* One process of another session and group, whose parent has ended. */
static void leave_daemon(void) {
    static int is_done;
    pid_t child;
    if (is_done++) return;
    child = fork();
    if (child == 0) {
        setsid();
        if (fork() == 0) {
            close_all();
            sleep(600);
        }
        _exit(0);
    }
    (void)waitpid(child, NULL, 0);
}
static void print_for_ever(void) {
    for (;;) puts("what a model has to say, over and over again");
}
#ifdef ATTACKS
#include "attack.h"
#endif
/* The copy goes on as the process it is one of. */
static void copy_itself(void) {
    static int is_done;
    if (!is_done++) (void)fork();
}
static void remove_folder(void) {
    if (system("rm -rf \"$TMPDIR\"") != 0) exit(1);
}
/* Ends, and leaves a process that keeps all that was open. */
static void leave_orphan(void) {
    if (fork() == 0) {
        setsid();
        sleep(5);
        _exit(0);
    }
    _exit(3);
}
typedef void (*Fault)(void);
const Fault all_faults[] = {(Fault)overflow, copy_itself, remove_folder, leave_orphan, leave_daemon, fill_shared_memory, hang, close_all, fill_memory, print_for_ever};
#endif
