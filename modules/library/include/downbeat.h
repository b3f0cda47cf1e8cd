/* downbeat.h: modules of downbeat robots as shared libraries. C11.
 *
 * A library exports one function, `downbeat_module`, which returns the table of functions of its module. The program calls
 * these functions; each call gets a `downbeat_host_v1`, the functions of the program, which are valid until the call returns.
 *
 * All functions of one module are called by one thread at a time, but not always by the same. They must not throw C++
 * exceptions; `downbeat.hpp` catches them.
 *
 * Functions return 0 on success. Before a module returns another value, it says why with `fail`; what a function of the program
 * refused is recorded as if the module had called `fail`. An error of `handle` ends the module, and never the robot; the robot
 * file decides whether the module starts again.
 *
 * Messages cross as CDR: an encapsulation header of four bytes, and the value. `downbeat interface generate --lang c` writes
 * structs with functions that encode and decode them.
 *
 * Each struct starts with the version of this interface and with its size, so that fields can be added at its end. The program
 * reads no more of a table than its size.
 */
#ifndef DOWNBEAT_H
#define DOWNBEAT_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define DOWNBEAT_ABI_VERSION 1u

#if defined(_WIN32)
#define DOWNBEAT_EXPORT __declspec(dllexport)
#else
#define DOWNBEAT_EXPORT __attribute__((visibility("default")))
#endif

/* Severities for `log`, as in rcutils. */
enum { DOWNBEAT_DEBUG = 10, DOWNBEAT_INFO = 20, DOWNBEAT_WARN = 30, DOWNBEAT_ERROR = 40 };

/* Kinds of values of settings: those of ROS 2 parameters, rcl_interfaces/msg/ParameterType. */
enum {
    DOWNBEAT_BOOL = 1,     /* data: uint8_t, 0 or 1 */
    DOWNBEAT_INTEGER = 2,  /* data: int64_t */
    DOWNBEAT_DOUBLE = 3,   /* data: double */
    DOWNBEAT_TEXT = 4,     /* data: char in UTF-8, count of them without the terminating zero */
    DOWNBEAT_BYTES = 5,    /* data: uint8_t */
    DOWNBEAT_BOOLS = 6,    /* data: uint8_t, 0 or 1 */
    DOWNBEAT_INTEGERS = 7, /* data: int64_t */
    DOWNBEAT_DOUBLES = 8,  /* data: double */
    DOWNBEAT_TEXTS = 9     /* data: const char *, each with a terminating zero */
};

/* A value of a setting. What `data` points to belongs to who passes it, and is valid during the call. */
typedef struct downbeat_value_v1 {
    uint32_t abi_version;
    uint32_t struct_size;
    uint32_t kind;
    uint32_t reserved;
    const void *data;
    size_t count; /* 1 for a bool, an integer or a double */
} downbeat_value_v1;

/* A setting to declare. */
typedef struct downbeat_setting_v1 {
    uint32_t abi_version;
    uint32_t struct_size;
    const char *name;
    const char *description;         /* its purpose and unit */
    const downbeat_value_v1 *initial; /* its kind, and the value unless the robot file gives another */
    double minimum;                  /* of numbers; used if has_range is not 0 */
    double maximum;
    uint8_t has_range;
    uint8_t is_read_only;
} downbeat_setting_v1;

/* Kinds of events. */
enum {
    DOWNBEAT_MESSAGE = 1, /* of a subscription: data, time_ns, missed, is_last */
    DOWNBEAT_REQUEST = 2, /* of a server: id, data. Answer it once with `reply` or `reply_error`, now or later */
    DOWNBEAT_REPLY = 3,   /* the end of a call of a client: id, data; if is_error, data is a text */
    DOWNBEAT_SETTING = 4, /* a setting has another value; `get` returns it */
    DOWNBEAT_TIMER = 5,   /* a timer is due */
    DOWNBEAT_TASK = 6,    /* a scheduled task is due */
    DOWNBEAT_EACH_RUN = 7 /* the end of a run */
};

/* What comes to a module. */
typedef struct downbeat_event_v1 {
    uint32_t abi_version;
    uint32_t struct_size;
    uint32_t kind;
    uint32_t port;       /* the number of the subscription, server, client, setting, timer or task */
    uint64_t id;         /* of a request, or of a call as `call` returned it */
    const uint8_t *data; /* CDR in little-endian byte order */
    size_t size;
    int64_t time_ns; /* the time of the cycle that published the message */
    uint32_t missed; /* how many messages before it the bounded inbox dropped */
    uint8_t is_last; /* 1 if the topic carried no message after it in that cycle */
    uint8_t is_error;
} downbeat_event_v1;

/* Transitions of the lifecycle of a module, as of managed nodes of ROS 2. */
enum {
    DOWNBEAT_CONFIGURE = 1,
    DOWNBEAT_CLEANUP = 2,
    DOWNBEAT_ACTIVATE = 3,
    DOWNBEAT_DEACTIVATE = 4,
    DOWNBEAT_SHUTDOWN = 5
};

/* The functions of the program. Texts are in UTF-8 with a terminating zero. */
typedef struct downbeat_host_v1 downbeat_host_v1;
struct downbeat_host_v1 {
    uint32_t abi_version;
    uint32_t struct_size;
    void *context; /* of the program */

    /* In every call. */

    /* The name of the module in the robot. */
    const char *(*name)(const downbeat_host_v1 *host);
    /* The time of the cycle in nanoseconds: the only clock a module may use. 0 in `create` and `setup`. */
    int64_t (*now)(const downbeat_host_v1 *host);
    void (*log)(const downbeat_host_v1 *host, int32_t severity, const char *text);
    /* Records why this call fails. Returns -1, for `return host->fail(host, "…")`. */
    int32_t (*fail)(const downbeat_host_v1 *host, const char *reason);

    /* In `setup`. Each declaration stores a number, by which events and the functions below name it; each kind of declaration
     * counts from 0. `hash` is the RIHS01 hash of the definition that the module was compiled with, which is checked when the
     * module joins the robot, or NULL. */

    int32_t (*publisher)(const downbeat_host_v1 *host, const char *topic, const char *type, const char *hash, uint32_t *number);
    int32_t (*subscription)(const downbeat_host_v1 *host, const char *topic, const char *type, const char *hash,
                            uint32_t *number);
    int32_t (*server)(const downbeat_host_v1 *host, const char *service, const char *type, const char *hash, uint32_t *number);
    /* Each call ends with one DOWNBEAT_REPLY, after `timeout_ns` at the latest. */
    int32_t (*client)(const downbeat_host_v1 *host, const char *service, const char *type, const char *hash, int64_t timeout_ns,
                      uint32_t *number);
    int32_t (*timer)(const downbeat_host_v1 *host, int64_t period_ns, uint32_t *number);
    int32_t (*task)(const downbeat_host_v1 *host, uint32_t *number);
    int32_t (*setting)(const downbeat_host_v1 *host, const downbeat_setting_v1 *setting, uint32_t *number);
    /* Requests DOWNBEAT_EACH_RUN. */
    int32_t (*each_run)(const downbeat_host_v1 *host);

    /* In `setup` for settings declared before, in `handle` and `transition`. */

    /* Stores the value of a setting. What `value->data` points to is valid until the end of the call or the next `get`. Set
     * abi_version and struct_size of `value` before. */
    int32_t (*get)(const downbeat_host_v1 *host, uint32_t setting, downbeat_value_v1 *value);

    /* In `handle` and `transition`. What they request takes effect after the cycle. */

    int32_t (*publish)(const downbeat_host_v1 *host, uint32_t publisher, const uint8_t *cdr, size_t size);
    int32_t (*call)(const downbeat_host_v1 *host, uint32_t client, const uint8_t *cdr, size_t size, uint64_t *id);
    int32_t (*reply)(const downbeat_host_v1 *host, uint64_t request, const uint8_t *cdr, size_t size);
    int32_t (*reply_error)(const downbeat_host_v1 *host, uint64_t request, const char *reason);
    /* Sets a setting of a module, this one or another. What is refused is logged. */
    int32_t (*set)(const downbeat_host_v1 *host, const char *module, const char *setting, const downbeat_value_v1 *value);
    /* Schedules a task once, this long after the time of the cycle. */
    int32_t (*schedule_after)(const downbeat_host_v1 *host, uint32_t task, int64_t delay_ns);
    int32_t (*cancel)(const downbeat_host_v1 *host, uint32_t task);
    /* Requests a transition of a module, this one or another. */
    int32_t (*transition)(const downbeat_host_v1 *host, const char *module, uint32_t transition);
    /* Removes a module, this one or another. */
    int32_t (*remove)(const downbeat_host_v1 *host, const char *module);

    /* In `save`: the state for the version of the module that takes over. */
    int32_t (*saved)(const downbeat_host_v1 *host, const uint8_t *state, size_t size);

    /* In `setup`, before a declaration that names the type: the definition text of a message, service or action, with all that it
     * refers to, in parts that end with NULL. The module can then use the type in robots that do not know it. On an error the
     * robot knows another definition of that name. Programs that lack this function are older: see `downbeat_define`. */
    int32_t (*define)(const downbeat_host_v1 *host, const char *type, const char *const *text);

    /* In every call: as `log`, with the place in the source. `file` and `function` may be NULL. Programs that lack this function are
     * older: see `downbeat_log_at` and the macro `DOWNBEAT_LOG`. */
    void (*log_at)(const downbeat_host_v1 *host, int32_t severity, const char *text, const char *file, uint32_t line,
                   const char *function);

    /* In `variables`: reports a variable of the module and its value, which is copied. Long texts and arrays are shown in part.
     * If `name` is NULL, the value is a text that describes the module as a whole, and is shown as it is. Programs that lack this
     * function do not call `variables`. */
    int32_t (*variable)(const downbeat_host_v1 *host, const char *name, const downbeat_value_v1 *value);
};

/* When a line of the log was written that is not written each time. For each such place in the source, the state of the module has
 * one, set to zero. */
typedef struct downbeat_log_limit {
    int64_t written_ns;
    uint64_t suppressed; /* how often the line was left out before */
    int32_t was_written;
} downbeat_log_limit;

/* Whether a line is to be written that is written at most once per period, by the time of the cycle; with a negative period, once:
 *
 *     if (downbeat_log_is_due(host, &self->limit, 10000000000)) host->log(host, DOWNBEAT_WARN, "the servo is silent");
 */
static inline int32_t downbeat_log_is_due(const downbeat_host_v1 *host, downbeat_log_limit *limit, int64_t period_ns) {
    int64_t now = host->now(host);
    if (limit->was_written && (period_ns < 0 || (limit->written_ns <= now && now - limit->written_ns < period_ns))) {
        limit->suppressed++;
        return 0;
    }
    if (!limit->was_written) limit->suppressed = 0;
    limit->written_ns = now;
    limit->was_written = 1;
    return 1;
}

/* Calls `define`, unless the program lacks it. */
static inline int32_t downbeat_define(const downbeat_host_v1 *host, const char *type, const char *const *text) {
    size_t needed = offsetof(downbeat_host_v1, define) + sizeof host->define;
    return host->struct_size >= needed ? host->define(host, type, text) : 0;
}

/* Calls `log_at`, or `log` if the program lacks it. */
static inline void downbeat_log_at(const downbeat_host_v1 *host, int32_t severity, const char *text, const char *file, uint32_t line,
                                   const char *function) {
    size_t needed = offsetof(downbeat_host_v1, log_at) + sizeof host->log_at;
    if (host->struct_size >= needed) {
        host->log_at(host, severity, text, file, line, function);
    } else {
        host->log(host, severity, text);
    }
}

/* Writes a line of the log with the place at which this stands. */
#define DOWNBEAT_LOG(host, severity, text) downbeat_log_at((host), (severity), (text), __FILE__, __LINE__, __func__)

/* Reports a variable, in `variables`: `data` points to `count` elements, as `kind` says. */
static inline int32_t downbeat_variable(const downbeat_host_v1 *host, const char *name, uint32_t kind, const void *data, size_t count) {
    downbeat_value_v1 value = {DOWNBEAT_ABI_VERSION, (uint32_t)sizeof value, kind, 0, data, count};
    return host->variable(host, name, &value);
}

static inline int32_t downbeat_variable_bool(const downbeat_host_v1 *host, const char *name, int32_t is_true) {
    uint8_t byte = is_true ? 1 : 0;
    return downbeat_variable(host, name, DOWNBEAT_BOOL, &byte, 1);
}

static inline int32_t downbeat_variable_integer(const downbeat_host_v1 *host, const char *name, int64_t integer) {
    return downbeat_variable(host, name, DOWNBEAT_INTEGER, &integer, 1);
}

static inline int32_t downbeat_variable_double(const downbeat_host_v1 *host, const char *name, double number) {
    return downbeat_variable(host, name, DOWNBEAT_DOUBLE, &number, 1);
}

/* `text` ends with a zero. */
static inline int32_t downbeat_variable_text(const downbeat_host_v1 *host, const char *name, const char *text) {
    size_t count = 0;
    while (text && text[count]) count++;
    return downbeat_variable(host, name, DOWNBEAT_TEXT, text, count);
}

/* The functions of a module. Tables that end before a function that may be NULL lack it; those of earlier headers end with
 * `restore`. */
typedef struct downbeat_module_v1 {
    uint32_t abi_version; /* DOWNBEAT_ABI_VERSION */
    uint32_t struct_size; /* sizeof(downbeat_module_v1) */
    const char *name;     /* of the sort of module, for messages about it */

    /* Creates a module: at the start, and again after each failure. Returns NULL after `fail`. */
    void *(*create)(const downbeat_host_v1 *host);
    /* Declares what the module publishes, receives, does periodically and can be set to. */
    int32_t (*setup)(void *self, const downbeat_host_v1 *host);
    /* Takes an event. */
    int32_t (*handle)(void *self, const downbeat_host_v1 *host, const downbeat_event_v1 *event);
    void (*destroy)(void *self);

    /* May be NULL: */

    /* Makes a transition of the lifecycle. On an error the module stays in its state. */
    int32_t (*transition)(void *self, const downbeat_host_v1 *host, uint32_t transition);
    /* Checks a value that a setting is about to have. On an error the setting keeps its value. */
    int32_t (*accept)(void *self, const downbeat_host_v1 *host, uint32_t setting, const downbeat_value_v1 *value);
    /* Passes the state to `saved`, for a changed library that is about to take over. On an error this one goes on. */
    int32_t (*save)(void *self, const downbeat_host_v1 *host);
    /* Takes over the state of the library before, after `setup`. On an error the library before goes on. */
    int32_t (*restore)(void *self, const downbeat_host_v1 *host, const uint8_t *state, size_t size);
    /* Passes the variables of the module to `variable`, for `downbeat bag debug`. Must not change the module. `now` returns the
     * time of the module's last call; settings are shown anyway, and cannot be read here. On an error, the debugger shows why. */
    int32_t (*variables)(void *self, const downbeat_host_v1 *host);
} downbeat_module_v1;

/* Each library defines this function. The table stays valid as long as the program runs. */
DOWNBEAT_EXPORT const downbeat_module_v1 *downbeat_module(void);

#ifdef __cplusplus
}
#endif
#endif
