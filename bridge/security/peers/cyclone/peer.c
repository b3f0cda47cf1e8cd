/* A participant of Cyclone DDS, with or without DDS Security, for the tests of this package.
 *
 * usage: peer DOMAIN_ID ENCLAVE COMMAND...
 *   ENCLAVE                the folder of the six files of sros2, or - for a participant without security
 *   publish TOPIC TEXT     publishes "TEXT 1", "TEXT 2", … ten times a second (std_msgs/msg/String)
 *   subscribe TOPIC        prints each sample
 *   serve SERVICE          answers requests (std_srvs/srv/SetBool)
 *   call SERVICE DATA      sends a request each second until the response arrives; DATA is true or false
 *   fill TOPIC SIZE        publishes SIZE times "x" and a number, once a second (std_msgs/msg/String)
 *   keep TOPIC TEXT        publishes TEXT once, transient local
 *   recall TOPIC           prints each sample, transient local
 *   list NODE              asks for the names of the parameters of a node each second until the response arrives
 *   move TOPIC JOINT POS   publishes the position of a joint ten times a second (sensor_msgs/msg/JointState)
 *   joint TOPIC JOINT      prints the position of a joint in each sample
 * TOPIC, SERVICE and NODE are names of ROS 2 with their leading slash. The program ends when its standard input does.
 *
 * It prints one line for each event: "ready", "heard TOPIC TEXT", "served SERVICE DATA", "answered SERVICE MESSAGE",
 * "listed NODE NAME NAME…", "joint TOPIC POSITION".
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

typedef struct { uint32_t maximum, length; char **buffer; bool release; } Strings;
typedef struct { Header header; Strings prefixes; uint64_t depth; } ListRequest;
static const uint32_t list_request_ops[] = {
  DDS_OP_ADR | DDS_OP_TYPE_8BY, offsetof(ListRequest, header.client), DDS_OP_ADR | DDS_OP_TYPE_8BY, offsetof(ListRequest, header.sequence),
  DDS_OP_ADR | DDS_OP_TYPE_SEQ | DDS_OP_SUBTYPE_STR, offsetof(ListRequest, prefixes),
  DDS_OP_ADR | DDS_OP_TYPE_8BY, offsetof(ListRequest, depth), DDS_OP_RTS };
typedef struct { Header header; Strings names, prefixes; } ListResponse;
static const uint32_t list_response_ops[] = {
  DDS_OP_ADR | DDS_OP_TYPE_8BY, offsetof(ListResponse, header.client), DDS_OP_ADR | DDS_OP_TYPE_8BY, offsetof(ListResponse, header.sequence),
  DDS_OP_ADR | DDS_OP_TYPE_SEQ | DDS_OP_SUBTYPE_STR, offsetof(ListResponse, names),
  DDS_OP_ADR | DDS_OP_TYPE_SEQ | DDS_OP_SUBTYPE_STR, offsetof(ListResponse, prefixes), DDS_OP_RTS };

typedef struct { uint32_t maximum, length; double *buffer; bool release; } Doubles;
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
static const dds_topic_descriptor_t list_request_type =
  DESCRIPTOR(ListRequest, "rcl_interfaces::srv::dds_::ListParameters_Request_", list_request_ops);
static const dds_topic_descriptor_t list_response_type =
  DESCRIPTOR(ListResponse, "rcl_interfaces::srv::dds_::ListParameters_Response_", list_response_ops);
static const dds_topic_descriptor_t joint_state_type = DESCRIPTOR(JointState, "sensor_msgs::msg::dds_::JointState_", joint_state_ops);

typedef struct {
  enum { PUBLISH, SUBSCRIBE, SERVE, CALL, FILL, KEEP, RECALL, LIST, MOVE, JOINT } kind;
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
  static const struct { const char *name; int kind, size; } kinds[] = {
    { "publish", PUBLISH, 3 }, { "subscribe", SUBSCRIBE, 2 }, { "serve", SERVE, 2 }, { "call", CALL, 3 },
    { "fill", FILL, 3 }, { "keep", KEEP, 3 }, { "recall", RECALL, 2 }, { "list", LIST, 2 },
    { "move", MOVE, 4 }, { "joint", JOINT, 3 } };
  int used = 0;
  for (int at = 0; at < count && used < MOST_COMMANDS; used++) {
    size_t index = 0;
    while (index < sizeof kinds / sizeof kinds[0] && strcmp(arguments[at], kinds[index].name) != 0) index++;
    if (index == sizeof kinds / sizeof kinds[0] || count - at < kinds[index].size) return -1;
    Command *command = &commands[used];
    *command = (Command) { .kind = kinds[index].kind, .name = arguments[at + 1] + 1 };
    if (kinds[index].size == 4) command->position = atof(arguments[at + 3]);
    if (kinds[index].size >= 3) command->text = arguments[at + 2];
    command->data = command->text && strcmp(command->text, "true") == 0;
    at += kinds[index].size;
  }
  return used;
}

static void start(Command *command, dds_entity_t participant, const dds_qos_t *qos, const dds_qos_t *latched)
{
  const char *name = command->name;
  char service[256];
  switch (command->kind) {
    case PUBLISH: case FILL: case KEEP:
      command->writer = writer(participant, topic(participant, "rt/", name, "", &string_type), command->kind == KEEP ? latched : qos, name);
      return;
    case SUBSCRIBE: case RECALL:
      command->reader = reader(participant, topic(participant, "rt/", name, "", &string_type), command->kind == RECALL ? latched : qos, name);
      return;
    case MOVE:
      command->writer = writer(participant, topic(participant, "rt/", name, "", &joint_state_type), qos, name);
      return;
    case JOINT:
      command->reader = reader(participant, topic(participant, "rt/", name, "", &joint_state_type), qos, name);
      return;
    default: break;
  }
  const bool is_list = command->kind == LIST, is_client = is_list || command->kind == CALL;
  snprintf(service, sizeof service, "%s%s", name, is_list ? "/list_parameters" : "");
  const dds_entity_t requests = topic(participant, "rq/", service, "Request", is_list ? &list_request_type : &request_type);
  const dds_entity_t responses = topic(participant, "rr/", service, "Reply", is_list ? &list_response_type : &response_type);
  command->writer = writer(participant, is_client ? requests : responses, qos, name);
  command->reader = reader(participant, is_client ? responses : requests, qos, name);
}

static void print_joint(const Command *command, const JointState *state)
{
  for (uint32_t at = 0; at < state->name.length && at < state->position.length; at++)
    if (strcmp(state->name.buffer[at], command->text) == 0)
      printf("joint /%s %.3f\n", command->name, state->position.buffer[at]);
}

static void receive(Command *command)
{
  if (command->reader == 0) return;
  for (;;) {
    void *sample = NULL;
    dds_sample_info_t info;
    if (dds_take(command->reader, &sample, &info, 1, 1) != 1) return;
    if (info.valid_data && (command->kind == SUBSCRIBE || command->kind == RECALL))
      printf("heard /%s %s\n", command->name, ((const String *) sample)->data);
    else if (info.valid_data && command->kind == JOINT)
      print_joint(command, sample);
    else if (info.valid_data && command->kind == SERVE) {
      const Request *request = sample;
      printf("served /%s %s\n", command->name, text(request->data));
      dds_write(command->writer, &(Response) { request->header, request->data, request->data ? "data is true" : "data is false" });
    }
    else if (info.valid_data && command->kind == LIST && !command->is_answered) {
      const Strings *names = &((const ListResponse *) sample)->names;
      printf("listed /%s", command->name);
      for (uint32_t at = 0; at < names->length; at++) printf(" %s", names->buffer[at]);
      puts("");
      command->is_answered = true;
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
  else if (command->kind == FILL && tick % 10 == 0) {
    const size_t size = (size_t) atol(command->text);
    char *text = malloc(size + 32);
    memset(text, 'x', size);
    snprintf(text + size, 32, " %" PRId64, ++command->count);
    dds_write(command->writer, &(String) { .data = text });
    free(text);
  }
  else if (command->kind == MOVE) {
    char *joint = (char *) command->text;
    dds_write(command->writer, &(JointState) {
      .frame_id = "", .name = { 1, 1, &joint, false }, .position = { 1, 1, &command->position, false } });
  }
  else if (command->kind == KEEP && tick == 0)
    dds_write(command->writer, &(String) { .data = (char *) command->text });
  else if (command->kind == LIST && !command->is_answered && tick % 10 == 0)
    dds_write(command->writer, &(ListRequest) { { (uint64_t) getpid(), ++command->count }, { 0 }, 0 });
  else if (command->kind == CALL && !command->is_answered && tick % 10 == 0)
    dds_write(command->writer, &(Request) { { (uint64_t) getpid(), ++command->count }, command->data });
}

int main(int count, char **arguments)
{
  Command commands[MOST_COMMANDS];
  const int used = count > 3 ? parse(commands, count - 3, arguments + 3) : -1;
  if (used < 0) {
    fprintf(stderr, "usage: %s DOMAIN_ID ENCLAVE COMMAND..., see the head of its source\n", arguments[0]);
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
  dds_qos_t *latched = dds_create_qos();
  dds_copy_qos(latched, qos);
  dds_qset_durability(latched, DDS_DURABILITY_TRANSIENT_LOCAL);
  for (int at = 0; at < used; at++) start(&commands[at], participant, qos, latched);
  dds_delete_qos(qos);
  dds_delete_qos(latched);
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
