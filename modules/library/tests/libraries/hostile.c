/* Reports variables that are none, and more than anybody reads. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "downbeat.h"

enum { LARGE = 1 << 20 };

static void *create(const downbeat_host_v1 *host) {
    (void)host;
    char *large = malloc(LARGE);
    if (large) memset(large, 'x', LARGE);
    return large;
}

static int32_t setup(void *self, const downbeat_host_v1 *host) {
    (void)self;
    return host->publisher(host, "out", "std_msgs/msg/Empty", NULL, NULL) || host->each_run(host);
}

static int32_t handle(void *self, const downbeat_host_v1 *host, const downbeat_event_v1 *event) {
    (void)self;
    (void)event;
    /* Refused, and no failure. */
    downbeat_variable_bool(host, "too early", 1);
    return 0;
}

static void destroy(void *self) { free(self); }

static int32_t variables(void *self, const downbeat_host_v1 *host) {
    const char *large = self;
    const char *texts[3] = {"a\xff", NULL, "b"};
    const double numbers[3] = {0.25, 0.0, 1e300};
    downbeat_value_v1 short_value = {DOWNBEAT_ABI_VERSION, 8, DOWNBEAT_BOOL, 0, large, 1};
    downbeat_variable(host, "line\nbreak \xfe\x1b[31m", DOWNBEAT_TEXT, "\xc3\x28 \x1b[31m", 8);
    downbeat_variable(host, "large", DOWNBEAT_TEXT, large, LARGE);
    downbeat_variable(host, "bytes", DOWNBEAT_BYTES, large, LARGE);
    downbeat_variable(host, "texts", DOWNBEAT_TEXTS, texts, 3);
    downbeat_variable(host, "unaligned", DOWNBEAT_DOUBLES, (const char *)numbers + 1, 2);
    downbeat_variable(host, "unknown", 77, large, 1);
    downbeat_variable(host, "nothing", DOWNBEAT_TEXT, NULL, 1);
    downbeat_variable(host, "two", DOWNBEAT_INTEGER, numbers, 2);
    host->variable(host, "null", NULL);
    host->variable(host, "short", &short_value);
    downbeat_variable(host, NULL, DOWNBEAT_BOOL, large, 1);
    host->publish(host, 0, NULL, 0);
    host->remove(host, "module");
    for (int number = 0; number < 5000; number++) {
        char name[32];
        snprintf(name, sizeof name, "number_%d", number);
        downbeat_variable_integer(host, name, number);
    }
#ifdef FAILS
    return host->fail(host, "there is no joint 21");
#endif
    return 0;
}

DOWNBEAT_EXPORT const downbeat_module_v1 *downbeat_module(void) {
    static const downbeat_module_v1 module = {
        .abi_version = DOWNBEAT_ABI_VERSION, .struct_size = sizeof module, .name = "hostile\xff", .create = create, .setup = setup,
        .handle = handle, .destroy = destroy, .variables = variables};
    return &module;
}
