/* What ends or stops the process of a model: FAULT, where k is above FAULT_ABOVE and the time above 0.2. */
#include <signal.h>
#include <unistd.h>
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
    for (i = 3; i < 256; i++) close(i);
    for (;;) pause();
}
static void fill_memory(void) {
    size_t size = (size_t)1 << 30;
    for (;;) memset(malloc(size), 1, size);
}
static void print_for_ever(void) {
    for (;;) puts("what a model has to say, over and over again");
}
typedef void (*Fault)(void);
const Fault all_faults[] = {(Fault)overflow, hang, close_all, fill_memory, print_for_ever};
#endif
