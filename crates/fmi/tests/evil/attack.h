/* What a hostile model tries in a sandbox. It is harmless: it writes marker files below OUTSIDE, connects to PORT of this
   machine, and makes calls that change nothing where they are not refused. */
#include <dirent.h>
#include <fcntl.h>
#include <mqueue.h>
#include <pthread.h>
#include <sched.h>
#include <stdint.h>
#include <sys/ioctl.h>
#include <sys/ipc.h>
#include <sys/ptrace.h>
#include <sys/resource.h>
#include <sys/shm.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <sys/uio.h>
#include <sys/xattr.h>

#ifdef OUTSIDE
/* Writes a file with this name, and sends the name to the port; once, for a worker that dies is replaced. */
static void attempt(const char *who) {
    char path[512];
    struct sockaddr_in address = {0};
    int file, connection;
    snprintf(path, sizeof path, "%s/%s", OUTSIDE, who);
    file = open(path, O_CREAT | O_EXCL | O_WRONLY, 0600);
    if (file < 0 && errno == EEXIST) return;
    if (file >= 0) close(file);
    connection = socket(AF_INET, SOCK_STREAM, 0);
    address.sin_family = AF_INET;
    address.sin_port = htons(PORT);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (connect(connection, (struct sockaddr *)&address, sizeof address) == 0) (void)!write(connection, who, strlen(who));
    if (connection >= 0) close(connection);
}

static volatile int handled;
static void on_signal(int signal) {
    char who[32];
    (void)signal;
    snprintf(who, sizeof who, "handler-%d", __atomic_fetch_add(&handled, 1, __ATOMIC_SEQ_CST));
    attempt(who);
}
static void at_end_of_thread(void *unused) { (void)unused; attempt("end-of-thread"); }
static void *in_thread(void *key) {
    attempt("thread");
    pthread_setspecific(*(pthread_key_t *)key, key);
    return NULL;
}
static void at_exit(void) { attempt("exit"); }
static int is_attacking;
__attribute__((destructor)) static void at_unloading(void) {
    if (is_attacking) attempt("unloading");
}

/* Tries it from each place from which code of a model can run, and ends the process with 3. */
static void attack(void) {
    static pthread_key_t key;
    struct dirent *entry;
    pthread_t thread;
    int n = 0, waited;
    pid_t child;
    DIR *threads = opendir("/proc/self/task");
    is_attacking = 1;
    attempt("call");
    signal(SIGUSR1, on_signal);
    while (threads != NULL && (entry = readdir(threads)) != NULL) {
        if (atoi(entry->d_name) > 0 && syscall(SYS_tgkill, getpid(), atoi(entry->d_name), SIGUSR1) == 0) n++;
    }
    for (waited = 0; waited < 1000 && handled < n; waited++) usleep(1000);
    usleep(20000);
    pthread_key_create(&key, at_end_of_thread);
    if (pthread_create(&thread, NULL, in_thread, &key) == 0) pthread_join(thread, NULL);
    child = fork();
    if (child == 0) {
        attempt("child");
        _exit(0);
    }
    (void)waitpid(child, NULL, 0);
    atexit(at_exit);
    printf("%d handlers in %d threads\n", handled, n);
    fflush(stdout);
    exit(3);
}

/* Prints each call that is not refused, and each that is refused although models need it; ends the process with 9. */
#define REFUSED(call) do { errno = 0; if ((long)(call) != -1 || (errno != EPERM && errno != EACCES && errno != ENOSYS && errno != EXDEV)) \
    printf("not refused: %s (%d)\n", #call, errno); } while (0)
#define ALLOWED(call) do { errno = 0; if ((long)(call) == -1) printf("refused: %s (%d)\n", #call, errno); } while (0)
static void probe(void) {
    const char *own = OUTSIDE "/own";
    struct timeval times[2] = {{0, 0}, {0, 0}};
    struct rlimit limit;
    struct sched_param parameter = {0};
    char zeros[256] = {0};
    long flags = 0;
    int file = open(own, O_RDONLY);
    int parent = getppid();
    ALLOWED(file);
    ALLOWED(chdir(OUTSIDE));
    ALLOWED(kill(getpid(), 0));
    ALLOWED(fcntl(file, F_GETFL));
    ALLOWED(getpriority(PRIO_PROCESS, 0));
    ALLOWED(open("/dev/null", O_WRONLY));
    ALLOWED(open("/dev/urandom", O_RDONLY));
    ALLOWED(chdir(getenv("TMPDIR")));
    ALLOWED(mkdir("folder", 0700));
    ALLOWED(open("folder/file", O_CREAT | O_RDWR | O_TRUNC, 0600));
    ALLOWED(rename("folder/file", "file"));
    REFUSED(socket(AF_INET, SOCK_STREAM, 0));
    REFUSED(socket(AF_INET, SOCK_STREAM, 262 /* IPPROTO_MPTCP */));
    REFUSED(socket(AF_INET6, SOCK_DGRAM, 0));
    REFUSED(socket(AF_UNIX, SOCK_STREAM, 0));
    REFUSED(socket(AF_NETLINK, SOCK_RAW, 0));
    REFUSED(socketpair(AF_UNIX, SOCK_DGRAM, 0, (int *)zeros));
    REFUSED(syscall(425 /* io_uring_setup */, 4, zeros));
    REFUSED(kill(parent, 0));
    REFUSED(kill(0, 0));
    REFUSED(kill(-1, 0));
    REFUSED(syscall(SYS_tgkill, parent, parent, 0));
    REFUSED(syscall(SYS_tkill, parent, 0));
    REFUSED(syscall(SYS_rt_sigqueueinfo, parent, 0, zeros));
    REFUSED(fcntl(file, F_SETOWN, parent));
    REFUSED(fcntl(file, F_SETLEASE, F_WRLCK));
    REFUSED(ptrace(PTRACE_SEIZE, parent, 0, 0));
    REFUSED(process_vm_readv(parent, NULL, 0, NULL, 0, 0));
    REFUSED(syscall(434 /* pidfd_open */, parent, 0));
    REFUSED(syscall(SYS_prlimit64, parent, RLIMIT_NOFILE, NULL, &limit));
    REFUSED(setpriority(PRIO_USER, 0, getpriority(PRIO_USER, 0)));
    REFUSED(sched_setscheduler(parent, SCHED_OTHER, &parameter));
    REFUSED(open("/proc/1/environ", O_RDONLY));
    REFUSED(open("/dev/tty", O_RDONLY));
    REFUSED(open("/dev/ptmx", O_RDWR));
    REFUSED(ioctl(0, TIOCSTI, ""));
    REFUSED(ioctl(file, 0x40086602 /* FS_IOC_SETFLAGS */, &flags));
    REFUSED(chmod(own, 0777));
    REFUSED(fchmod(file, 0777));
    REFUSED(syscall(452 /* fchmodat2 */, AT_FDCWD, own, 0777, 0));
    REFUSED(chown(own, getuid(), getgid()));
    REFUSED(utimes(own, times));
    REFUSED(futimens(file, NULL));
    REFUSED(setxattr(own, "user.marker", "1", 1, 0));
    REFUSED(truncate(own, 0));
    REFUSED(open(own, O_RDONLY | O_TRUNC));
    REFUSED(open(own, O_ACCMODE | O_TRUNC));
    REFUSED(open(own, O_WRONLY));
    REFUSED(rename(own, OUTSIDE "/moved"));
    REFUSED(link(own, "linked"));
    REFUSED(unlink(own));
    REFUSED(mknod("device", S_IFCHR | 0600, 0x103));
    REFUSED(shmget(IPC_PRIVATE, 4096, IPC_CREAT | 0600));
    REFUSED(syscall(SYS_mq_open, "marker", O_RDONLY, 0, NULL));
    REFUSED(syscall(SYS_keyctl, 0, -3, 0));
    REFUSED(unshare(0x10000000 /* CLONE_NEWUSER */));
    REFUSED(syscall(SYS_clone, 0x10000000 | SIGCHLD, 0, 0, 0, 0) == 0 ? (_exit(0), 0) : -1);
    REFUSED(syscall(435 /* clone3 */, NULL, 0));
    REFUSED(syscall(437 /* openat2 */, AT_FDCWD, own, zeros, 24));
    REFUSED(syscall(1000));
    REFUSED(syscall(SYS_setns, -1, 0));
    REFUSED(syscall(SYS_mount, "", "", "", 0, NULL));
    REFUSED(syscall(SYS_bpf, 0, zeros, 8));
    REFUSED(syscall(SYS_perf_event_open, zeros, 0, -1, -1, 0));
#ifdef __x86_64__
    REFUSED(syscall(0x40000000 | SYS_socket, AF_INET, SOCK_STREAM, 0));
#endif
    puts("all tried");
    fflush(stdout);
    _exit(9);
}
#endif

/* The page that the worker shares with its parent, and the worker's socket. */
static volatile uint32_t *shared_page(void) {
    char line[512], *place = NULL;
    unsigned long begin;
    FILE *maps = fopen("/proc/self/maps", "r");
    while (maps != NULL && place == NULL && fgets(line, sizeof line, maps) != NULL) {
        if (strstr(line, "memfd:fmufit-worker") != NULL && sscanf(line, "%lx", &begin) == 1) place = (char *)begin;
    }
    if (maps != NULL) fclose(maps);
    return (volatile uint32_t *)place;
}
static int worker_socket(void) {
    struct stat status;
    int file;
    for (file = 3; file < 64; file++) {
        if (fstat(file, &status) == 0 && S_ISSOCK(status.st_mode)) return file;
    }
    return -1;
}

/* Claims the begin of one simulation after the other (the second word of the page), without end. */
static void claim_runs(void) {
    volatile uint32_t *page = shared_page();
    for (;; usleep(1000)) page[1]++;
}

/* Begins an answer to the present question, whose number is at the begin of the page's last part. */
static int begin_answer(uint64_t head, uint64_t numbers) {
    /* The parent writes the number after it has sent the question. */
    usleep(20000);
    uint32_t number = shared_page()[(32 + 160 * 48 + 127) / 128 * 128 / 4];
    uint32_t words[4] = {0x464d5501, 0, number, 0};
    uint64_t lengths[3] = {head, 0, numbers};
    int to = worker_socket();
    (void)!write(to, words, sizeof words);
    (void)!write(to, lengths, sizeof lengths);
    return to;
}
static void answer_byte_by_byte(void) {
    int to = begin_answer(1 << 20, 0);
    for (;; usleep(2000)) (void)!write(to, "", 1);
}
static void answer_too_much(void) {
    int to = begin_answer(0, (uint64_t)1 << 25);
    static char block[1 << 16];
    for (;;) (void)!write(to, block, sizeof block);
}
/* A map that ends before its first entry (RFC 8949). */
static void answer_cut_off(void) {
    (void)!write(begin_answer(1, 0), "\xa2", 1);
    for (;;) pause();
}
