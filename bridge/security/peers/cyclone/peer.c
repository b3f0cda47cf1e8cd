/* A participant of Cyclone DDS, with or without DDS Security, for the tests of this package.
 *
 * usage: peer DOMAIN_ID ENCLAVE COMMAND...
 *   ENCLAVE                the folder of the six files of sros2, or - for a participant without security
 *   publish TOPIC TEXT     publishes "TEXT 1", "TEXT 2", … ten times a second (std_msgs/msg/String)
 *   subscribe TOPIC        prints each sample
 *   serve SERVICE          answers requests (std_srvs/srv/SetBool)
 *   call SERVICE DATA      sends a request each second until the response arrives; DATA is true or false
 *   move TOPIC JOINT POS   publishes the position of a joint ten times a second (sensor_msgs/msg/JointState)
 *   joint TOPIC JOINT      prints the position of a joint in each sample
 * TOPIC and SERVICE are names of ROS 2 with their leading slash. The program ends when its standard input does.
 *
 * It prints one line for each event: "ready", "heard TOPIC TEXT", "served SERVICE DATA", "answered SERVICE MESSAGE", "joint TOPIC POSITION".
 */
#include <inttypes.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "dds/dds.h"

#ifndef PLUGINS
#error "define PLUGINS as the folder of libdds_security_{auth,ac,crypto}.so"
#endif

#define MOST_COMMANDS 16

typedef struct { char *data; } String;
static const uint32_t string_ops[] = { DDS_OP_ADR | DDS_OP_TYPE_STR, offsetof(String, data), DDS_OP_RTS };

/* rmw_cyclonedds_cpp puts this header in front of each request and response. */
typedef struct { uint64_t client; int64_t sequence; } Header;
typedef struct { Header header; bool data; } Request;
static const uint32_t request_ops[] = {
  DDS_OP_ADR | DDS_OP_TYPE_8BY, offsetof(Request, header.client), DDS_OP_ADR | DDS_OP_TYPE_8BY, offsetof(Request, header.sequence),
  DDS_OP_ADR | DDS_OP_TYPE_BLN, offsetof(Request, data), DDS_OP_RTS };
typedef struct { Header header; bool success; char *message; } Response;
static const uint32_t response_ops[] = {
  DDS_OP_ADR | DDS_OP_TYPE_8BY, offsetof(Response, header.client), DDS_OP_ADR | DDS_OP_TYPE_8BY, offsetof(Response, header.sequence),
  DDS_OP_ADR | DDS_OP_TYPE_BLN, offsetof(Response, success), DDS_OP_ADR | DDS_OP_TYPE_STR, offsetof(Response, message), DDS_OP_RTS };

/* The sequences have the layout of dds_sequence_t. */
typedef struct { uint32_t _maximum, _length; char **_buffer; bool _release; } Strings;
typedef struct { uint32_t _maximum, _length; double *_buffer; bool _release; } Doubles;
typedef struct { int32_t sec; uint32_t nanosec; char *frame_id; Strings name; Doubles position, velocity, effort; } JointState;
static const uint32_t joint_state_ops[] = {
  DDS_OP_ADR | DDS_OP_TYPE_4BY, offsetof(JointState, sec), DDS_OP_ADR | DDS_OP_TYPE_4BY, offsetof(JointState, nanosec),
  DDS_OP_ADR | DDS_OP_TYPE_STR, offsetof(JointState, frame_id),
  DDS_OP_ADR | DDS_OP_TYPE_SEQ | DDS_OP_SUBTYPE_STR, offsetof(JointState, name),
  DDS_OP_ADR | DDS_OP_TYPE_SEQ | DDS_OP_SUBTYPE_8BY, offsetof(JointState, position),
  DDS_OP_ADR | DDS_OP_TYPE_SEQ | DDS_OP_SUBTYPE_8BY, offsetof(JointState, velocity),
  DDS_OP_ADR | DDS_OP_TYPE_SEQ | DDS_OP_SUBTYPE_8BY, offsetof(JointState, effort), DDS_OP_RTS };

#define DESCRIPTOR(type, name, ops) { .m_size = sizeof(type), .m_align = sizeof(void *), .m_typename = name, \
  .m_nops = sizeof(ops) / sizeof(ops[0]), .m_ops = ops, .m_meta = "" }
static const dds_topic_descriptor_t string_type = DESCRIPTOR(String, "std_msgs::msg::dds_::String_", string_ops);
static const dds_topic_descriptor_t request_type = DESCRIPTOR(Request, "std_srvs::srv::dds_::SetBool_Request_", request_ops);
static const dds_topic_descriptor_t response_type = DESCRIPTOR(Response, "std_srvs::srv::dds_::SetBool_Response_", response_ops);
static const dds_topic_descriptor_t joint_state_type = DESCRIPTOR(JointState, "sensor_msgs::msg::dds_::JointState_", joint_state_ops);

typedef struct {
  enum { PUBLISH, SUBSCRIBE, SERVE, CALL, MOVE, JOINT } kind;
  const char *name, *text;
  bool data;
  double position;
  dds_entity_t writer, reader;
  int64_t count;
  bool is_answered;
} Command;

static const char *text(bool value) { return value ? "true" : "false"; }

static void fail(const char *what, const char *name, dds_return_t code)
{
  fprintf(stderr, "peer: cannot create the %s of %s: %s\n", what, name, dds_strretcode(-code));
  exit(1);
}

static dds_entity_t topic(dds_entity_t participant, const char *prefix, const char *name, const char *suffix,
                          const dds_topic_descriptor_t *type)
{
  char dds_name[512];
  snprintf(dds_name, sizeof dds_name, "%s%s%s", prefix, name, suffix);
  const dds_entity_t topic = dds_create_topic(participant, type, dds_name, NULL, NULL);
  if (topic < 0) fail("topic", dds_name, topic);
  return topic;
}

static dds_entity_t writer(dds_entity_t participant, dds_entity_t topic, const dds_qos_t *qos, const char *name)
{
  const dds_entity_t writer = dds_create_writer(participant, topic, qos, NULL);
  if (writer < 0) fail("writer", name, writer);
  return writer;
}

static dds_entity_t reader(dds_entity_t participant, dds_entity_t topic, const dds_qos_t *qos, const char *name)
{
  const dds_entity_t reader = dds_create_reader(participant, topic, qos, NULL);
  if (reader < 0) fail("reader", name, reader);
  return reader;
}

static void configure(uint32_t domain_id, const char *enclave)
{
  char security[4096] = "", configuration[8192];
  if (strcmp(enclave, "-") != 0)
    snprintf(security, sizeof security,
      "<Security>"
      "<Authentication><Library path=\"" PLUGINS "/libdds_security_auth.so\" initFunction=\"init_authentication\" "
      "finalizeFunction=\"finalize_authentication\"/><IdentityCA>file:%s/identity_ca.cert.pem</IdentityCA>"
      "<IdentityCertificate>file:%s/cert.pem</IdentityCertificate><PrivateKey>file:%s/key.pem</PrivateKey></Authentication>"
      "<AccessControl><Library path=\"" PLUGINS "/libdds_security_ac.so\" initFunction=\"init_access_control\" "
      "finalizeFunction=\"finalize_access_control\"/><PermissionsCA>file:%s/permissions_ca.cert.pem</PermissionsCA>"
      "<Governance>file:%s/governance.p7s</Governance><Permissions>file:%s/permissions.p7s</Permissions></AccessControl>"
      "<Cryptographic><Library path=\"" PLUGINS "/libdds_security_crypto.so\" initFunction=\"init_crypto\" "
      "finalizeFunction=\"finalize_crypto\"/></Cryptographic></Security>",
      enclave, enclave, enclave, enclave, enclave, enclave);
  snprintf(configuration, sizeof configuration,
    "<Domain id=\"any\"><General><Interfaces><NetworkInterface name=\"lo\" multicast=\"false\"/></Interfaces>"
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex><Peers><Peer address=\"127.0.0.1\"/></Peers></Discovery>"
    "%s<Tracing><Verbosity>warning</Verbosity><OutputFile>stderr</OutputFile></Tracing></Domain>", security);
  const dds_entity_t domain = dds_create_domain(domain_id, configuration);
  if (domain < 0) fail("domain", enclave, domain);
}

static int parse(Command *commands, int count, char **arguments)
{
  int used = 0;
  for (int at = 0; at < count && used < MOST_COMMANDS; used++) {
    Command *command = &commands[used];
    *command = (Command) { .name = at + 1 < count ? arguments[at + 1] + 1 : NULL };
    const int left = count - at;
    if (left >= 3 && strcmp(arguments[at], "publish") == 0)
      command->kind = PUBLISH, command->text = arguments[at + 2], at += 3;
    else if (left >= 2 && strcmp(arguments[at], "subscribe") == 0)
      command->kind = SUBSCRIBE, at += 2;
    else if (left >= 2 && strcmp(arguments[at], "serve") == 0)
      command->kind = SERVE, at += 2;
    else if (left >= 3 && strcmp(arguments[at], "call") == 0)
      command->kind = CALL, command->data = strcmp(arguments[at + 2], "true") == 0, at += 3;
    else if (left >= 4 && strcmp(arguments[at], "move") == 0)
      command->kind = MOVE, command->text = arguments[at + 2], command->position = atof(arguments[at + 3]), at += 4;
    else if (left >= 3 && strcmp(arguments[at], "joint") == 0)
      command->kind = JOINT, command->text = arguments[at + 2], at += 3;
    else
      return -1;
  }
  return used;
}

static void start(Command *command, dds_entity_t participant, const dds_qos_t *qos)
{
  const char *name = command->name;
  const bool is_client = command->kind == CALL;
  if (command->kind == PUBLISH || command->kind == SUBSCRIBE) {
    const dds_entity_t strings = topic(participant, "rt/", name, "", &string_type);
    if (command->kind == PUBLISH) command->writer = writer(participant, strings, qos, name);
    else command->reader = reader(participant, strings, qos, name);
    return;
  }
  if (command->kind == MOVE || command->kind == JOINT) {
    const dds_entity_t states = topic(participant, "rt/", name, "", &joint_state_type);
    if (command->kind == MOVE) command->writer = writer(participant, states, qos, name);
    else command->reader = reader(participant, states, qos, name);
    return;
  }
  const dds_entity_t requests = topic(participant, "rq/", name, "Request", &request_type);
  const dds_entity_t responses = topic(participant, "rr/", name, "Reply", &response_type);
  command->writer = writer(participant, is_client ? requests : responses, qos, name);
  command->reader = reader(participant, is_client ? responses : requests, qos, name);
}

static void print_joint(const Command *command, const JointState *state)
{
  for (uint32_t at = 0; at < state->name._length && at < state->position._length; at++)
    if (strcmp(state->name._buffer[at], command->text) == 0)
      printf("joint /%s %.3f\n", command->name, state->position._buffer[at]);
}

static void receive(Command *command)
{
  if (command->reader == 0) return;
  for (;;) {
    void *sample = NULL;
    dds_sample_info_t info;
    if (dds_take(command->reader, &sample, &info, 1, 1) != 1) return;
    if (info.valid_data && command->kind == SUBSCRIBE)
      printf("heard /%s %s\n", command->name, ((const String *) sample)->data);
    else if (info.valid_data && command->kind == JOINT)
      print_joint(command, sample);
    else if (info.valid_data && command->kind == SERVE) {
      const Request *request = sample;
      printf("served /%s %s\n", command->name, text(request->data));
      dds_write(command->writer, &(Response) { request->header, request->data, request->data ? "data is true" : "data is false" });
    }
    else if (info.valid_data && !command->is_answered) {
      printf("answered /%s %s\n", command->name, ((const Response *) sample)->message);
      command->is_answered = true;
    }
    dds_return_loan(command->reader, &sample, 1);
  }
}

static void send(Command *command, int64_t tick)
{
  if (command->kind == PUBLISH) {
    const size_t size = strlen(command->text) + 32;
    char *text = malloc(size);
    snprintf(text, size, "%s %" PRId64, command->text, ++command->count);
    dds_write(command->writer, &(String) { .data = text });
    free(text);
  }
  else if (command->kind == MOVE) {
    char *joint = (char *) command->text;
    JointState state = { .frame_id = "", .name = { 1, 1, &joint, false }, .position = { 1, 1, &command->position, false } };
    dds_write(command->writer, &state);
  }
  else if (command->kind == CALL && !command->is_answered && tick % 10 == 0)
    dds_write(command->writer, &(Request) { { (uint64_t) getpid(), ++command->count }, command->data });
}

int main(int count, char **arguments)
{
  Command commands[MOST_COMMANDS];
  const int used = count > 3 ? parse(commands, count - 3, arguments + 3) : -1;
  if (used < 0) {
    fprintf(stderr, "usage: %s DOMAIN_ID ENCLAVE (publish TOPIC TEXT|subscribe TOPIC|serve SERVICE|call SERVICE DATA|move TOPIC JOINT POSITION|joint TOPIC JOINT)...\n", arguments[0]);
    return 2;
  }
  setvbuf(stdout, NULL, _IOLBF, 0);
  const uint32_t domain_id = (uint32_t) atoi(arguments[1]);
  configure(domain_id, arguments[2]);
  const dds_entity_t participant = dds_create_participant(domain_id, NULL, NULL);
  if (participant < 0) fail("participant", arguments[2], participant);
  dds_qos_t *qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
  dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 10);
  for (int at = 0; at < used; at++) start(&commands[at], participant, qos);
  dds_delete_qos(qos);
  puts("ready");

  struct pollfd input = { .fd = STDIN_FILENO, .events = POLLIN };
  char ignored[256];
  for (int64_t tick = 0;; tick++) {
    for (int at = 0; at < used; at++) {
      receive(&commands[at]);
      send(&commands[at], tick);
    }
    if (poll(&input, 1, 100) > 0 && read(STDIN_FILENO, ignored, sizeof ignored) <= 0) break;
  }
  dds_delete(DDS_CYCLONEDDS_HANDLE);
  return 0;
}
