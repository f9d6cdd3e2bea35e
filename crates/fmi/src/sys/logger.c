/* What Rust cannot write: variadic logger callbacks, and the memory callbacks of FMI 1.0 and 2.0.
 *
 * The logger asks whether a message is wanted at all, expands it into a buffer of fixed size on the stack and passes
 * pointer and length to the sink of the instance that the thread is calling (see callbacks.rs). The environment that an
 * FMU passes is never dereferenced: FMUs are known that pass NULL or a constant. Every pointer that an FMU passes may be
 * NULL. */

#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define TEXT_SIZE 2048
#define NAME_SIZE 256

/* The same layout as `Environment` in callbacks.rs. */
struct fmufit_environment {
    int (*admits)(void *data, int status);
    void (*sink)(void *data, int status, const char *category, size_t category_length, const char *text,
                 size_t text_length);
    void *data;
};

#if defined(_MSC_VER)
#define THREAD_LOCAL __declspec(thread)
#else
#define THREAD_LOCAL _Thread_local
#endif

/* The environment of the instance that this thread has called last. Environments are never freed. */
static THREAD_LOCAL const struct fmufit_environment *current;

/* The environment at an address, or NULL if there is none; set before the first instance is made. */
static const struct fmufit_environment *(*find)(const void *address);

void fmufit_set_find(const struct fmufit_environment *(*function)(const void *address))
{
    find = function;
}

void fmufit_enter(const struct fmufit_environment *environment)
{
    current = environment;
}

/* Receiver of a message. A thread that belongs to the FMU calls no instance: then the address that it passes is
 * compared with those of the environments. */
static const struct fmufit_environment *receiver(const void *passed)
{
    if (current != NULL || find == NULL) {
        return current;
    }
    return find(passed);
}

static size_t bounded_length(const char *text, size_t limit)
{
    size_t n = 0;
    while (n < limit && text[n] != '\0') {
        n++;
    }
    return n;
}

/* At most three digits: a field of a million places is no message. */
static const char *skip_digits(const char *format)
{
    int n;
    for (n = 0; n < 3 && *format >= '0' && *format <= '9'; n++) {
        format++;
    }
    return format;
}

/* Whether a format holds nothing but plain conversions: %s %c %p, %f %g %e, %d %i %u %x (also of long, short and size_t
 * arguments) with a width and a precision in digits, and %%. Anything else makes the message plain text: texts that
 * were never meant as formats ("100 % successful") would read arguments that are not there, %n writes. */
static int is_plain(const char *format)
{
    while (*format != '\0') {
        const char *size;
        if (*format++ != '%') {
            continue;
        }
        if (*format == '%') {
            format++;
            continue;
        }
        format = skip_digits(format);
        if (*format == '.') {
            format = skip_digits(format + 1);
        }
        size = format;
        if (*format == 'h' || *format == 'z') {
            format++;
        } else if (*format == 'l') {
            format += format[1] == 'l' ? 2 : 1;
        }
        if (*format == '\0') {
            return 0;
        }
        if (strchr("diux", *format) == NULL && !(format == size && strchr("scpfge", *format) != NULL) &&
            !(format == size + 1 && *size == 'l' && strchr("fge", *format) != NULL)) {
            return 0;
        }
        format++;
    }
    return 1;
}

static void expand(const struct fmufit_environment *environment, int status, const char *category,
                   const char *message, va_list arguments)
{
    char text[TEXT_SIZE];
    size_t length = 0;
    int written = -1;

    if (environment == NULL || !environment->admits(environment->data, status)) {
        return;
    }
    if (message == NULL) {
        message = "";
    }
    if (is_plain(message)) {
        written = vsnprintf(text, sizeof text, message, arguments);
    }
    if (written >= 0) {
        length = bounded_length(text, sizeof text - 1);
    } else {
        length = bounded_length(message, sizeof text - 1);
        memcpy(text, message, length);
    }
    if ((size_t)(written < 0 ? 0 : written) >= sizeof text) {
        memcpy(text + sizeof text - 4, "...", 3);
    }
    environment->sink(environment->data, status, category == NULL ? "" : category,
                      category == NULL ? 0 : bounded_length(category, NAME_SIZE), text, length);
}

/* FMI 2.0; for FMI 1.0 the first argument is the component. */
void fmufit_log(void *passed, const char *instance_name, int status, const char *category, const char *message, ...)
{
    va_list arguments;
    (void)instance_name;
    va_start(arguments, message);
    expand(receiver(passed), status, category, message, arguments);
    va_end(arguments);
}

/* FMI 3.0, whose logger takes a finished text. */
void fmufit_fmi3_log(void *passed, int status, const char *category, const char *message)
{
    fmufit_log(passed, NULL, status, category, "%s", message == NULL ? "" : message);
}

void *fmufit_allocate(size_t count, size_t size)
{
    return calloc(count, size);
}

void fmufit_free(void *block)
{
    free(block);
}
