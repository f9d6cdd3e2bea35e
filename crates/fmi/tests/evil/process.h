/* What the model does to its thread, its process and the loader, one fault at a time, chosen by a macro. */
#include <stdlib.h>
#if defined(FLUSHES) || defined(FLOAT_IN)
#include <xmmintrin.h>
#endif
#if defined(SIGNALS_IN) || defined(BLOCKS_IN)
#include <signal.h>
#endif
#ifdef DIRECTORY_IN
#include <unistd.h>
#endif
#include <locale.h>

#ifdef CLASHES
/* A function of the C library; which one is called is a matter of how this library is loaded. */
EXPORT int atoi(const char *text) { (void)text; return 7; }
#endif
#ifdef THREAD_DATA
#include <pthread.h>
static pthread_key_t key;
static void thread_ends(void *p) { (void)p; }
__attribute__((constructor)) static void make_key(void) { pthread_key_create(&key, thread_ends); }
#endif

/* What an FMU does to its thread and its process, and where: FLOAT_IN, SIGNALS_IN, BLOCKS_IN, LOCALE_IN, DIRECTORY_IN. */
enum { INSTANTIATE = 1, SET_TIME, DERIVATIVES, STEP, FREE, INITIALIZE, END };

static void upset(int where) {
    (void)where;
#ifdef FLOAT_IN
#ifndef FLOAT_FROM /* so many times nothing happens */
#define FLOAT_FROM 0
#endif
    static int times;
    if (where == FLOAT_IN && times++ >= FLOAT_FROM) {
        unsigned short x87;
        __asm__ volatile("fnstcw %0" : "=m"(x87));
#ifdef ROUNDS_UP
        _mm_setcsr((_mm_getcsr() & ~0x6000u) | 0x4000u);
        x87 = (unsigned short)((x87 & ~0x0c00u) | 0x0800u);
#else /* unmasks all exceptions */
        _mm_setcsr(_mm_getcsr() & ~0x1fbfu);
        x87 &= (unsigned short)~0x3fu;
#endif
        __asm__ volatile("fnclex; fldcw %0" : : "m"(x87));
    }
#endif
#ifdef SIGNALS_IN
    if (where == SIGNALS_IN) {
        signal(SIGINT, SIG_IGN);
        signal(SIGFPE, SIG_IGN);
        signal(SIGTERM, SIG_IGN);
    }
#endif
#ifdef BLOCKS_IN
    if (where == BLOCKS_IN) {
        sigset_t all;
        sigfillset(&all);
        pthread_sigmask(SIG_SETMASK, &all, NULL);
    }
#endif
#ifdef DIRECTORY_IN
    if (where == DIRECTORY_IN && chdir("/") != 0) abort();
#endif
#ifdef LOCALE_IN
    if (where == LOCALE_IN) setlocale(LC_ALL, getenv("EVIL_LOCALE"));
#endif
}
#ifdef DIES_WITH_TWO
/* Two threads in this library at once end the process. */
static int inside;
static void enter(void) {
    int i;
    if (__atomic_fetch_add(&inside, 1, __ATOMIC_SEQ_CST) != 0) abort();
    for (i = 0; i < 1000; i++) __asm__ volatile("");
}
static void leave(void) { __atomic_fetch_sub(&inside, 1, __ATOMIC_SEQ_CST); }
#else
#define enter()
#define leave()
#endif

#ifdef DIES_WITH_TWO_INSTANCES
static int alive;
#endif

#ifdef LARGE_TLS
/* Static thread-local storage is set aside once per process and is small. */
static __thread volatile char large[LARGE_TLS] __attribute__((tls_model("initial-exec")));
#endif
