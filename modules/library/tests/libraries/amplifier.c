/* Publishes on `out` what it receives on `in`, times its setting `gain`. */
#include "std_msgs/msg/float64.h"

typedef struct amplifier {
    std_msgs__msg__Float64 message;
    downbeat_writer writer;
    downbeat_log_limit began;
    int64_t received;
} amplifier;

static void *create(const downbeat_host_v1 *host) {
    (void)host;
    return calloc(1, sizeof(amplifier));
}

static int32_t setup(void *self, const downbeat_host_v1 *host) {
    (void)self;
    const double one = 2.0;
    const downbeat_value_v1 initial = {DOWNBEAT_ABI_VERSION, sizeof initial, DOWNBEAT_DOUBLE, 0, &one, 1};
    const downbeat_setting_v1 gain = {DOWNBEAT_ABI_VERSION, sizeof gain, "gain", "of the output", &initial, 0.0, 10.0, 1, 0};
    const char *type = std_msgs__msg__Float64__TYPE;
    const char *hash = std_msgs__msg__Float64__HASH;
#ifdef WRONG_HASH
    hash = "RIHS01_00";
#endif
#ifdef ERROR_IN_SETUP
    return host->fail(host, "no camera");
#endif
    if (host->publisher(host, "out", type, hash, NULL) || host->subscription(host, "in", type, hash, NULL)) {
        return -1;
    }
    return host->setting(host, &gain, NULL);
}

static int32_t handle(void *self, const downbeat_host_v1 *host, const downbeat_event_v1 *event) {
    amplifier *of = (amplifier *)self;
    if (event->kind != DOWNBEAT_MESSAGE) {
        return 0;
    }
    downbeat_value_v1 gain = {DOWNBEAT_ABI_VERSION, sizeof gain, 0, 0, NULL, 0};
    if (host->get(host, 0, &gain) || std_msgs__msg__Float64__take(host, event, &of->message)) {
        return -1;
    }
    of->received++;
    if (of->message.data < 0.0) {
        return host->fail(host, "a negative number");
    }
    if (of->message.data == 1234.0) {
        return 7;
    }
    if (of->message.data == 4321.0) {
        return host->publish(host, 0, (const uint8_t *)"\0\1\0\0", 4);
    }
    if (downbeat_log_is_due(host, &of->began, -1)) {
        host->log(host, DOWNBEAT_INFO, "amplifies");
    }
    of->message.data *= *(const double *)gain.data;
    return std_msgs__msg__Float64__publish(host, 0, &of->message, &of->writer);
}

static int32_t variables(void *self, const downbeat_host_v1 *host) {
    const amplifier *of = (const amplifier *)self;
    const double last[2] = {of->message.data, (double)host->now(host) / 1e9};
    return downbeat_variable_integer(host, "received", of->received) ||
           downbeat_variable_bool(host, "has_begun", of->began.was_written) ||
           downbeat_variable_double(host, "out", of->message.data) ||
           downbeat_variable_text(host, "text", "in \"C\"") ||
           downbeat_variable(host, "last", DOWNBEAT_DOUBLES, last, 2);
}

static void destroy(void *self) {
    downbeat_writer_fini(&((amplifier *)self)->writer);
    free(self);
}

#ifndef VERSION
#define VERSION DOWNBEAT_ABI_VERSION
#endif
#ifndef SIZE
#define SIZE sizeof(downbeat_module_v1)
#endif
#ifndef SYMBOL
#define SYMBOL downbeat_module
#endif

DOWNBEAT_EXPORT const downbeat_module_v1 *SYMBOL(void) {
    static const downbeat_module_v1 module = {VERSION, SIZE, "amplifier", create, setup, handle, destroy, NULL, NULL, NULL, NULL, variables};
#ifdef NO_TABLE
    return NULL;
#endif
    return &module;
}
