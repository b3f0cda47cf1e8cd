/* downbeat_action.h: actions that modules in C serve and use (design.ros2.org/articles/actions.html). C11.
 *
 * `downbeat interface generate --lang c` writes the functions that depend on the type, here those of my_msgs/action/Turn. A server is a
 * field of the module that starts as zeros:
 *
 *     in setup:   my_msgs__action__Turn__serve(host, "turn", &self->turn)
 *     in handle:  downbeat_goal *goal;
 *                 int32_t code = downbeat_action_take(host, &self->turn, event, &goal);
 *                 if (goal) { my_msgs__action__Turn__goal(host, goal, &wanted); then downbeat_goal_accept or downbeat_goal_reject }
 *     later:      for (goal = self->turn.goals; goal; goal = goal->next) if (downbeat_goal_is_active(goal)) { … }
 *                 my_msgs__action__Turn__publish_feedback(host, &self->turn, goal, &feedback)
 *                 my_msgs__action__Turn__end(host, &self->turn, goal, DOWNBEAT_GOAL_SUCCEEDED, &result)
 *     in destroy: downbeat_action_server_fini(&self->turn)
 *
 * Clients who ask for results or to cancel goals are answered by `downbeat_action_take`. A client of an action:
 *
 *     in setup:   my_msgs__action__Turn__use(host, "turn", timeout_ns, &self->turn)
 *     then:       my_msgs__action__Turn__send(host, &self->turn, &wanted, id)
 *     in handle:  downbeat_goal_news news;
 *                 int32_t code = downbeat_action_hear(host, &self->turn, event, &news);
 *                 if (news.kind == DOWNBEAT_GOAL_FEEDBACK) my_msgs__action__Turn__take_feedback(host, event, &feedback);
 *                 if (news.kind == DOWNBEAT_GOAL_END && !news.error) my_msgs__action__Turn__take_result(host, event, &result);
 *     in destroy: downbeat_action_client_fini(&self->turn)
 */
#ifndef DOWNBEAT_ACTION_H
#define DOWNBEAT_ACTION_H

#include <stdio.h>

#include "downbeat.h"
#include "downbeat_cdr.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Where a goal stands: the values of action_msgs/msg/GoalStatus. */
enum {
    DOWNBEAT_GOAL_UNKNOWN = 0, /* neither accepted nor rejected so far */
    DOWNBEAT_GOAL_EXECUTING = 2,
    DOWNBEAT_GOAL_CANCELING = 3, /* a client asks to cancel it */
    DOWNBEAT_GOAL_SUCCEEDED = 4,
    DOWNBEAT_GOAL_CANCELED = 5,
    DOWNBEAT_GOAL_ABORTED = 6
};

/* What the functions below need to know of an action; the generator writes one of each. */
typedef struct downbeat_action_type {
    const char *send_goal, *send_goal_hash;
    const char *get_result, *get_result_hash;
    const char *cancel_goal, *cancel_goal_hash;
    const char *feedback, *feedback_hash;
    const char *status, *status_hash;
    void (*put_default_result)(downbeat_writer *writer);
} downbeat_action_type;

/* A goal of an action that the module serves. */
typedef struct downbeat_goal {
    uint8_t id[16];
    int8_t status;
    int64_t accepted_ns;
    int64_t ended_ns;
    void *user; /* of the module, which frees it */
    struct downbeat_goal *next;
    /* Of the functions below: */
    uint64_t open;    /* the request that asks for its acceptance */
    uint8_t *request; /* as CDR */
    size_t request_size;
    uint8_t *result; /* as CDR, of a goal that has ended */
    size_t result_size;
    uint64_t *waiting; /* requests for its result */
    size_t waiting_count, waiting_capacity;
} downbeat_goal;

/* An action that the module serves. Zero it before `serve`. */
typedef struct downbeat_action_server {
    downbeat_goal *goals; /* in the order in which they came */
    const downbeat_action_type *type;
    uint32_t send_goal, get_result, cancel_goal, feedback, status;
    downbeat_writer writer;
} downbeat_action_server;

static inline int32_t downbeat_goal_is_active(const downbeat_goal *goal) {
    return goal->status == DOWNBEAT_GOAL_EXECUTING || goal->status == DOWNBEAT_GOAL_CANCELING;
}

static inline int32_t downbeat_goal_is_canceling(const downbeat_goal *goal) {
    return goal->status == DOWNBEAT_GOAL_CANCELING;
}

static inline int32_t downbeat_goal_has_ended(const downbeat_goal *goal) { return goal->status >= DOWNBEAT_GOAL_SUCCEEDED; }

/* The name of a part of an action. */
static inline int32_t downbeat_action_part(const downbeat_host_v1 *host, char name[512], const char *action, const char *part) {
    int length = snprintf(name, 512, "%s/_action/%s", action, part);
    return length < 0 || length >= 512 ? host->fail(host, "the name of the action is longer than 480 bytes") : 0;
}

/* In `setup`; see `…__serve` of the action. */
static inline int32_t downbeat_action_serve(const downbeat_host_v1 *host, const char *action, const downbeat_action_type *type,
                                            downbeat_action_server *server) {
    char name[512];
    server->type = type;
    return downbeat_action_part(host, name, action, "send_goal") ||
           host->server(host, name, type->send_goal, type->send_goal_hash, &server->send_goal) ||
           downbeat_action_part(host, name, action, "get_result") ||
           host->server(host, name, type->get_result, type->get_result_hash, &server->get_result) ||
           downbeat_action_part(host, name, action, "cancel_goal") ||
           host->server(host, name, type->cancel_goal, type->cancel_goal_hash, &server->cancel_goal) ||
           downbeat_action_part(host, name, action, "feedback") ||
           host->publisher(host, name, type->feedback, type->feedback_hash, &server->feedback) ||
           downbeat_action_part(host, name, action, "status") ||
           host->publisher(host, name, type->status, type->status_hash, &server->status);
}

static inline void downbeat_goal_free(downbeat_goal *goal) {
    free(goal->request);
    free(goal->result);
    free(goal->waiting);
    free(goal);
}

static inline void downbeat_action_server_fini(downbeat_action_server *server) {
    while (server->goals) {
        downbeat_goal *goal = server->goals;
        server->goals = goal->next;
        downbeat_goal_free(goal);
    }
    downbeat_writer_fini(&server->writer);
}

/* Removes a goal. */
static inline void downbeat_action_forget(downbeat_action_server *server, downbeat_goal *goal) {
    for (downbeat_goal **place = &server->goals; *place; place = &(*place)->next) {
        if (*place == goal) {
            *place = goal->next;
            downbeat_goal_free(goal);
            return;
        }
    }
}

static inline downbeat_goal *downbeat_action_find(const downbeat_action_server *server, const uint8_t id[16]) {
    for (downbeat_goal *goal = server->goals; goal; goal = goal->next) {
        if (memcmp(goal->id, id, 16) == 0) {
            return goal;
        }
    }
    return NULL;
}

static inline void downbeat_put_time(downbeat_writer *writer, int64_t time_ns) {
    int64_t seconds = time_ns / 1000000000 - (time_ns % 1000000000 < 0 ? 1 : 0);
    downbeat_put_int32(writer, (int32_t)seconds);
    downbeat_put_uint32(writer, (uint32_t)(time_ns - seconds * 1000000000));
}

static inline void downbeat_put_goal_info(downbeat_writer *writer, const downbeat_goal *goal) {
    downbeat_put_uint8_array(writer, goal->id, 16);
    downbeat_put_time(writer, goal->accepted_ns);
}

static inline int32_t downbeat_action_reply(const downbeat_host_v1 *host, uint64_t request, const downbeat_writer *writer) {
    return writer->error ? host->fail(host, writer->error) : host->reply(host, request, writer->data, writer->size);
}

static inline int32_t downbeat_action_publish_status(const downbeat_host_v1 *host, downbeat_action_server *server) {
    downbeat_writer *writer = &server->writer;
    uint32_t count = 0;
    for (const downbeat_goal *goal = server->goals; goal; goal = goal->next) {
        count += goal->status != DOWNBEAT_GOAL_UNKNOWN;
    }
    downbeat_writer_start(writer);
    downbeat_put_uint32(writer, count);
    for (const downbeat_goal *goal = server->goals; goal; goal = goal->next) {
        if (goal->status != DOWNBEAT_GOAL_UNKNOWN) {
            downbeat_put_goal_info(writer, goal);
            downbeat_put_int8(writer, goal->status);
        }
    }
    return writer->error ? host->fail(host, writer->error) : host->publish(host, server->status, writer->data, writer->size);
}

static inline int32_t downbeat_action_accepted(const downbeat_host_v1 *host, downbeat_action_server *server, uint64_t request,
                                               bool is_accepted) {
    downbeat_writer_start(&server->writer);
    downbeat_put_bool(&server->writer, is_accepted);
    downbeat_put_time(&server->writer, host->now(host));
    return downbeat_action_reply(host, request, &server->writer);
}

/* Accepts a goal, in the callback that took it or later. */
static inline int32_t downbeat_goal_accept(const downbeat_host_v1 *host, downbeat_action_server *server, downbeat_goal *goal) {
    if (goal->status != DOWNBEAT_GOAL_UNKNOWN) {
        return host->fail(host, "the goal was accepted before");
    }
    goal->status = DOWNBEAT_GOAL_EXECUTING;
    goal->accepted_ns = host->now(host);
    int32_t code = downbeat_action_accepted(host, server, goal->open, true);
    return code ? code : downbeat_action_publish_status(host, server);
}

/* Rejects a goal, which is gone then. */
static inline int32_t downbeat_goal_reject(const downbeat_host_v1 *host, downbeat_action_server *server, downbeat_goal *goal) {
    if (goal->status != DOWNBEAT_GOAL_UNKNOWN) {
        return host->fail(host, "the goal was accepted before");
    }
    int32_t code = downbeat_action_accepted(host, server, goal->open, false);
    downbeat_action_forget(server, goal);
    return code;
}

/* Ends a goal with the result that `server->writer` has; see `…__end` of the action. */
static inline int32_t downbeat_goal_end(const downbeat_host_v1 *host, downbeat_action_server *server, downbeat_goal *goal,
                                        int8_t status) {
    const downbeat_writer *writer = &server->writer;
    if (!downbeat_goal_is_active(goal)) {
        return host->fail(host, "the goal does not execute, and cannot end");
    }
    uint8_t *result = (uint8_t *)malloc(writer->error ? 1 : writer->size);
    if (writer->error || !result) {
        free(result);
        return host->fail(host, writer->error ? writer->error : "out of memory");
    }
    memcpy(result, writer->data, writer->size);
    goal->result = result;
    goal->result_size = writer->size;
    goal->status = status;
    goal->ended_ns = host->now(host);
    int32_t code = 0;
    for (size_t index = 0; code == 0 && index < goal->waiting_count; index++) {
        code = host->reply(host, goal->waiting[index], result, goal->result_size);
    }
    goal->waiting_count = 0;
    return code ? code : downbeat_action_publish_status(host, server);
}

static inline int32_t downbeat_action_take_goal(const downbeat_host_v1 *host, downbeat_action_server *server,
                                                const downbeat_event_v1 *event, const uint8_t id[16], downbeat_goal **taken) {
    /* How long a result is kept for those who ask for it, as in rclcpp's default. */
    const int64_t kept_ns = INT64_C(900000000000);
    for (downbeat_goal *goal = server->goals, *next; goal; goal = next) {
        next = goal->next;
        if (downbeat_goal_has_ended(goal) && host->now(host) - goal->ended_ns > kept_ns) {
            downbeat_action_forget(server, goal);
        }
    }
    if (downbeat_action_find(server, id)) {
        return downbeat_action_accepted(host, server, event->id, false);
    }
    downbeat_goal *goal = (downbeat_goal *)calloc(1, sizeof *goal);
    uint8_t *request = (uint8_t *)malloc(event->size);
    if (!goal || !request) {
        free(goal);
        free(request);
        return host->fail(host, "out of memory");
    }
    memcpy(goal->id, id, 16);
    memcpy(request, event->data, event->size);
    goal->request = request;
    goal->request_size = event->size;
    goal->open = event->id;
    downbeat_goal **place = &server->goals;
    while (*place) {
        place = &(*place)->next;
    }
    *place = goal;
    *taken = goal;
    return 0;
}

static inline int32_t downbeat_action_ask_result(const downbeat_host_v1 *host, downbeat_action_server *server, uint64_t request,
                                                 const uint8_t id[16]) {
    downbeat_goal *goal = downbeat_action_find(server, id);
    if (!goal) {
        downbeat_writer_start(&server->writer);
        downbeat_put_int8(&server->writer, DOWNBEAT_GOAL_UNKNOWN);
        server->type->put_default_result(&server->writer);
        return downbeat_action_reply(host, request, &server->writer);
    }
    if (downbeat_goal_has_ended(goal)) {
        return host->reply(host, request, goal->result, goal->result_size);
    }
    if (goal->waiting_count == goal->waiting_capacity) {
        size_t capacity = goal->waiting_capacity * 2 + 4;
        uint64_t *waiting = (uint64_t *)realloc(goal->waiting, capacity * sizeof *waiting);
        if (!waiting) {
            return host->fail(host, "out of memory");
        }
        goal->waiting = waiting;
        goal->waiting_capacity = capacity;
    }
    goal->waiting[goal->waiting_count++] = request;
    return 0;
}

static inline int32_t downbeat_action_cancel_goals(const downbeat_host_v1 *host, downbeat_action_server *server, uint64_t request,
                                                   const uint8_t id[16], int64_t before_ns) {
    static const uint8_t zero[16] = {0};
    /* A zero id and a zero time cancel all goals (action_msgs/srv/CancelGoal). */
    bool is_any = memcmp(id, zero, 16) == 0;
    uint32_t count = 0;
    for (int is_written = 0; is_written < 2; is_written++) {
        const downbeat_goal *known = downbeat_action_find(server, id);
        if (is_written) {
            int8_t code = count > 0 || is_any ? 0 : known && downbeat_goal_has_ended(known) ? 3 : 2;
            downbeat_writer_start(&server->writer);
            downbeat_put_int8(&server->writer, code);
            downbeat_put_uint32(&server->writer, count);
        }
        for (downbeat_goal *goal = server->goals; goal; goal = goal->next) {
            bool is_meant = (!is_any && goal == known) || (is_any && before_ns == 0) ||
                            (before_ns != 0 && goal->accepted_ns <= before_ns);
            if (!is_meant || !downbeat_goal_is_active(goal)) {
                continue;
            }
            if (is_written) {
                goal->status = DOWNBEAT_GOAL_CANCELING;
                downbeat_put_goal_info(&server->writer, goal);
            } else {
                count++;
            }
        }
    }
    int32_t code = downbeat_action_reply(host, request, &server->writer);
    return code ? code : downbeat_action_publish_status(host, server);
}

/* In `handle`: takes the requests of the action. A new goal is stored in `*goal`, which is NULL otherwise: accept or reject it. */
static inline int32_t downbeat_action_take(const downbeat_host_v1 *host, downbeat_action_server *server,
                                           const downbeat_event_v1 *event, downbeat_goal **goal) {
    *goal = NULL;
    bool is_goal = event->port == server->send_goal, is_result = event->port == server->get_result;
    bool is_cancel = event->port == server->cancel_goal;
    if (event->kind != DOWNBEAT_REQUEST || !server->type || !(is_goal || is_result || is_cancel)) {
        return 0;
    }
    downbeat_reader reader;
    uint8_t id[16] = {0};
    int32_t seconds = 0;
    uint32_t nanoseconds = 0;
    downbeat_reader_start(&reader, event->data, event->size);
    downbeat_get_uint8_array(&reader, id, 16);
    if (is_cancel) {
        downbeat_get_int32(&reader, &seconds);
        downbeat_get_uint32(&reader, &nanoseconds);
    }
    if (reader.error) {
        return host->reply_error(host, event->id, reader.error);
    }
    if (is_goal) {
        return downbeat_action_take_goal(host, server, event, id, goal);
    }
    if (is_result) {
        return downbeat_action_ask_result(host, server, event->id, id);
    }
    return downbeat_action_cancel_goals(host, server, event->id, id, seconds * INT64_C(1000000000) + nanoseconds);
}

/* A goal that the module has sent and whose end it has not heard. */
typedef struct downbeat_sent_goal {
    uint8_t id[16];
    uint64_t call; /* that asks for its acceptance, then for its result */
    bool is_accepted;
    struct downbeat_sent_goal *next;
} downbeat_sent_goal;

/* An action that the module uses. Zero it before `use`. */
typedef struct downbeat_action_client {
    downbeat_sent_goal *sent;
    const downbeat_action_type *type;
    uint32_t send_goal, get_result, cancel_goal, feedback;
    uint64_t count; /* of goals */
    downbeat_writer writer;
} downbeat_action_client;

enum { DOWNBEAT_GOAL_NOTHING = 0, DOWNBEAT_GOAL_FEEDBACK = 1, DOWNBEAT_GOAL_END = 2 };

/* What an event says about a goal that the module has sent. */
typedef struct downbeat_goal_news {
    int32_t kind;
    uint8_t id[16];
    int8_t status;     /* of a goal that has ended; DOWNBEAT_GOAL_UNKNOWN if there is no result */
    const char *error; /* why there is none, without a terminating zero; NULL if there is one */
    size_t error_size;
} downbeat_goal_news;

/* In `setup`; see `…__use` of the action. */
static inline int32_t downbeat_action_use(const downbeat_host_v1 *host, const char *action, int64_t timeout_ns,
                                          const downbeat_action_type *type, downbeat_action_client *client) {
    const int64_t year_ns = INT64_C(31536000000000000);
    char name[512];
    client->type = type;
    return downbeat_action_part(host, name, action, "send_goal") ||
           host->client(host, name, type->send_goal, type->send_goal_hash, timeout_ns, &client->send_goal) ||
           downbeat_action_part(host, name, action, "get_result") ||
           host->client(host, name, type->get_result, type->get_result_hash, year_ns, &client->get_result) ||
           downbeat_action_part(host, name, action, "cancel_goal") ||
           host->client(host, name, type->cancel_goal, type->cancel_goal_hash, timeout_ns, &client->cancel_goal) ||
           downbeat_action_part(host, name, action, "feedback") ||
           host->subscription(host, name, type->feedback, type->feedback_hash, &client->feedback);
}

static inline void downbeat_action_client_fini(downbeat_action_client *client) {
    while (client->sent) {
        downbeat_sent_goal *goal = client->sent;
        client->sent = goal->next;
        free(goal);
    }
    downbeat_writer_fini(&client->writer);
}

/* An id that differs for each goal of each module at each time, and is the same in a replay. */
static inline void downbeat_action_new_id(const downbeat_host_v1 *host, downbeat_action_client *client, uint8_t id[16]) {
    const char *name = host->name(host);
    int64_t parts[2] = {host->now(host), (int64_t)client->count++};
    for (size_t half = 0; half < 2; half++) {
        uint64_t hash = UINT64_C(14695981039346656037) + half; /* FNV-1a */
        for (size_t at = 0; at < strlen(name) + sizeof parts; at++) {
            size_t in_parts = at - strlen(name);
            uint8_t byte = at < strlen(name) ? (uint8_t)name[at] : (uint8_t)(parts[in_parts / 8] >> (in_parts % 8 * 8));
            hash = (hash ^ byte) * UINT64_C(1099511628211);
        }
        memcpy(id + 8 * half, &hash, sizeof hash);
    }
}

/* Sends the request that `client->writer` has; see `…__send` of the action. */
static inline int32_t downbeat_action_send(const downbeat_host_v1 *host, downbeat_action_client *client, const uint8_t id[16]) {
    if (client->writer.error) {
        return host->fail(host, client->writer.error);
    }
    downbeat_sent_goal *goal = (downbeat_sent_goal *)calloc(1, sizeof *goal);
    if (!goal) {
        return host->fail(host, "out of memory");
    }
    memcpy(goal->id, id, 16);
    goal->next = client->sent;
    client->sent = goal;
    return host->call(host, client->send_goal, client->writer.data, client->writer.size, &goal->call);
}

/* Asks to cancel a goal. */
static inline int32_t downbeat_action_cancel(const downbeat_host_v1 *host, downbeat_action_client *client, const uint8_t id[16]) {
    downbeat_writer *writer = &client->writer;
    downbeat_writer_start(writer);
    downbeat_put_uint8_array(writer, id, 16);
    downbeat_put_time(writer, 0);
    return writer->error ? host->fail(host, writer->error)
                         : host->call(host, client->cancel_goal, writer->data, writer->size, NULL);
}

/* The goal that news are about ends: it is forgotten. */
static inline void downbeat_action_ends(downbeat_action_client *client, downbeat_sent_goal *goal, downbeat_goal_news *news,
                                        const char *error, size_t error_size) {
    news->kind = DOWNBEAT_GOAL_END;
    news->error = error;
    news->error_size = error_size;
    for (downbeat_sent_goal **place = &client->sent; *place; place = &(*place)->next) {
        if (*place == goal) {
            *place = goal->next;
            free(goal);
            return;
        }
    }
}

/* In `handle`: takes what comes of the action. `news` says what it is, DOWNBEAT_GOAL_NOTHING for other events. */
static inline int32_t downbeat_action_hear(const downbeat_host_v1 *host, downbeat_action_client *client,
                                           const downbeat_event_v1 *event, downbeat_goal_news *news) {
    static const char refused[] = "the goal was refused";
    memset(news, 0, sizeof *news);
    bool is_reply = event->kind == DOWNBEAT_REPLY;
    bool is_accepted = is_reply && event->port == client->send_goal, is_result = is_reply && event->port == client->get_result;
    bool is_feedback = event->kind == DOWNBEAT_MESSAGE && event->port == client->feedback;
    if (!client->type || !(is_accepted || is_result || is_feedback)) {
        return 0;
    }
    downbeat_reader reader;
    memset(&reader, 0, sizeof reader);
    if (!event->is_error) {
        downbeat_reader_start(&reader, event->data, event->size);
    }
    if (is_feedback) {
        downbeat_get_uint8_array(&reader, news->id, 16);
        for (downbeat_sent_goal *goal = client->sent; goal; goal = goal->next) {
            if (!reader.error && memcmp(goal->id, news->id, 16) == 0) {
                news->kind = DOWNBEAT_GOAL_FEEDBACK;
            }
        }
        return reader.error ? host->fail(host, reader.error) : 0;
    }
    downbeat_sent_goal *goal = client->sent;
    /* Each client counts its calls. */
    while (goal && (goal->call != event->id || goal->is_accepted != is_result)) {
        goal = goal->next;
    }
    if (!goal) {
        return 0;
    }
    memcpy(news->id, goal->id, 16);
    if (event->is_error) {
        downbeat_action_ends(client, goal, news, (const char *)event->data, event->size);
        return 0;
    }
    if (is_result) {
        downbeat_get_int8(&reader, &news->status);
        downbeat_action_ends(client, goal, news, reader.error, reader.error ? strlen(reader.error) : 0);
        return 0;
    }
    bool was_accepted = false;
    downbeat_get_bool(&reader, &was_accepted);
    if (reader.error || !was_accepted) {
        const char *error = reader.error ? reader.error : refused;
        downbeat_action_ends(client, goal, news, error, strlen(error));
        return 0;
    }
    goal->is_accepted = true;
    downbeat_writer_start(&client->writer);
    downbeat_put_uint8_array(&client->writer, goal->id, 16);
    if (client->writer.error) {
        return host->fail(host, client->writer.error);
    }
    return host->call(host, client->get_result, client->writer.data, client->writer.size, &goal->call);
}

#ifdef __cplusplus
}
#endif
#endif
