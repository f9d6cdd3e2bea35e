/* What Rust cannot write: variadic logger callbacks, and the memory callbacks of FMI 1.0 and 2.0.
 *
 * The logger asks whether a message is wanted at all, expands it into a buffer of fixed size on the stack and hands pointer and length to the sink
 * that the environment names. There is no global state (but one pointer per thread for FMI 1.0, see callbacks.rs),
 * and every pointer that an FMU passes may be NULL. */

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

static size_t bounded_length(const char *text, size_t limit)
{
    size_t n = 0;
    while (n < limit && text[n] != '\0') {
        n++;
    }
    return n;
}

/* Whether a format holds nothing but complete conversions that only read. A lone % at the end, an unknown
 * conversion, or %n (which writes) make the message plain text. */
static int is_harmless(const char *format)
{
    while (*format != '\0') {
        if (*format++ != '%') {
            continue;
        }
        while (*format != '\0' && strchr(" -+#0'123456789.*hlLjzt", *format) != NULL) {
            format++;
        }
        if (*format == '\0' || strchr("diouxXeEfFgGaAcsp%", *format) == NULL) {
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

    if (environment == NULL || environment->sink == NULL || !environment->admits(environment->data, status)) {
        return;
    }
    if (message == NULL) {
        message = "";
    }
    if (is_harmless(message)) {
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

void fmufit_fmi2_log(void *component_environment, const char *instance_name, int status, const char *category,
                     const char *message, ...)
{
    va_list arguments;
    (void)instance_name;
    va_start(arguments, message);
    expand(component_environment, status, category, message, arguments);
    va_end(arguments);
}

#if defined(_MSC_VER)
#define THREAD_LOCAL __declspec(thread)
#else
#define THREAD_LOCAL _Thread_local
#endif

static THREAD_LOCAL void *current_environment;

void *fmufit_fmi1_enter(void *environment)
{
    void *before = current_environment;
    current_environment = environment;
    return before;
}

void fmufit_fmi1_log(void *component, const char *instance_name, int status, const char *category,
                     const char *message, ...)
{
    va_list arguments;
    (void)component;
    (void)instance_name;
    va_start(arguments, message);
    expand(current_environment, status, category, message, arguments);
    va_end(arguments);
}

void *fmufit_allocate(size_t count, size_t size)
{
    return calloc(count, size);
}

void fmufit_free(void *block)
{
    free(block);
}
