/* A module that was compiled with the first header of this version of the interface: its table ends with `restore`. */
#include <stdlib.h>

#include "downbeat.h"

typedef struct first_module_v1 {
    uint32_t abi_version;
    uint32_t struct_size;
    const char *name;
    void *(*create)(const downbeat_host_v1 *host);
    int32_t (*setup)(void *self, const downbeat_host_v1 *host);
    int32_t (*handle)(void *self, const downbeat_host_v1 *host, const downbeat_event_v1 *event);
    void (*destroy)(void *self);
    int32_t (*transition)(void *self, const downbeat_host_v1 *host, uint32_t transition);
    int32_t (*accept)(void *self, const downbeat_host_v1 *host, uint32_t setting, const downbeat_value_v1 *value);
    int32_t (*save)(void *self, const downbeat_host_v1 *host);
    int32_t (*restore)(void *self, const downbeat_host_v1 *host, const uint8_t *state, size_t size);
} first_module_v1;

static void *create(const downbeat_host_v1 *host) {
    (void)host;
    return malloc(1);
}

static int32_t setup(void *self, const downbeat_host_v1 *host) {
    (void)self;
    return host->each_run(host);
}

static int32_t handle(void *self, const downbeat_host_v1 *host, const downbeat_event_v1 *event) {
    (void)self;
    (void)host;
    (void)event;
    return 0;
}

static void destroy(void *self) { free(self); }

#ifndef SIZE
#define SIZE sizeof(first_module_v1)
#endif

/* Not of the table, and no function. */
static const struct {
    first_module_v1 table;
    uintptr_t behind[4];
} library = {{DOWNBEAT_ABI_VERSION, SIZE, "old", create, setup, handle, destroy, NULL, NULL, NULL, NULL}, {1, 2, 3, 4}};

DOWNBEAT_EXPORT const downbeat_module_v1 *downbeat_module(void) { return (const downbeat_module_v1 *)&library.table; }
