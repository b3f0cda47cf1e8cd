// A participant of Fast DDS, with or without DDS Security, for the tests of this package.
//
// usage: peer DOMAIN_ID ENCLAVE COMMAND...
//   ENCLAVE                the folder of the six files of sros2, or - for a participant without security
//   publish TOPIC TEXT     publishes "TEXT 1", "TEXT 2", … ten times a second (std_msgs/msg/String)
//   subscribe TOPIC        prints each sample
//   serve SERVICE          answers requests (std_srvs/srv/SetBool)
//   call SERVICE DATA      sends a request each second until the response arrives; DATA is true or false
//   fill TOPIC SIZE        publishes SIZE times "x" and a number, once a second (std_msgs/msg/String)
//   keep TOPIC TEXT        publishes TEXT once, transient local
//   recall TOPIC           prints each sample, transient local
//   list NODE              asks for the names of the parameters of a node each second until the response arrives
// TOPIC, SERVICE and NODE are names of ROS 2 with their leading slash. The program ends when its standard input does.
//
// It prints one line for each event: "ready", "heard TOPIC TEXT", "served SERVICE DATA", "answered SERVICE MESSAGE",
// "listed NODE NAME NAME…".
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/log/Log.hpp>
#include <fastdds/dds/log/StdoutErrConsumer.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

#include <poll.h>
#include <unistd.h>

#include <cstring>
#include <iostream>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

namespace fast = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;

using Bytes = std::vector<uint8_t>;

/// A type whose samples are CDR with its four bytes of encapsulation.
class Encoded : public fast::TopicDataType {
public:
    explicit Encoded(const std::string& name) {
        setName(name.c_str());
        m_typeSize = 2 << 20;
    }
    bool serialize(void* sample, rtps::SerializedPayload_t* payload) override {
        const auto& bytes = *static_cast<Bytes*>(sample);
        if (bytes.size() > payload->max_size) return false;
        std::memcpy(payload->data, bytes.data(), bytes.size());
        payload->length = static_cast<uint32_t>(bytes.size());
        payload->encapsulation = CDR_LE;
        return true;
    }
    bool deserialize(rtps::SerializedPayload_t* payload, void* sample) override {
        static_cast<Bytes*>(sample)->assign(payload->data, payload->data + payload->length);
        return true;
    }
    std::function<uint32_t()> getSerializedSizeProvider(void* sample) override {
        return [sample] { return static_cast<uint32_t>(static_cast<Bytes*>(sample)->size()); };
    }
    void* createData() override { return new Bytes; }
    void deleteData(void* sample) override { delete static_cast<Bytes*>(sample); }
    bool getKey(void*, rtps::InstanceHandle_t*, bool) override { return false; }
};

Bytes encapsulated() { return {0, 1, 0, 0}; }

void put(Bytes& bytes, const std::string& text) {
    while (bytes.size() % 4 != 0) bytes.push_back(0);
    const auto size = static_cast<uint32_t>(text.size() + 1);
    for (int at = 0; at < 4; at++) bytes.push_back(static_cast<uint8_t>(size >> (8 * at)));
    bytes.insert(bytes.end(), text.c_str(), text.c_str() + size);
}

uint32_t number_at(const Bytes& bytes, size_t offset) {
    uint32_t number = 0;
    for (int at = 0; at < 4; at++) number |= static_cast<uint32_t>(bytes.at(offset + at)) << (8 * at);
    return number;
}

/// The string at `offset`.
std::string text_at(const Bytes& bytes, size_t offset) {
    if (bytes.size() < offset + 5) return "(too short)";
    const uint32_t size = number_at(bytes, offset);
    if (size == 0 || size > bytes.size() - offset - 4) return "(wrong length)";
    return std::string(reinterpret_cast<const char*>(&bytes[offset + 4]), size - 1);
}

/// The strings of a sequence, each after a space.
std::string texts(const Bytes& bytes) {
    std::string all;
    size_t offset = 8;
    for (uint32_t left = number_at(bytes, 4); left > 0; left--) {
        const std::string text = text_at(bytes, offset);
        all += " " + text;
        offset = (offset + 4 + text.size() + 1 + 3) / 4 * 4;
    }
    return all;
}

struct Command {
    std::string kind, name, text;
    fast::DataWriter* writer = nullptr;
    fast::DataReader* reader = nullptr;
    int64_t count = 0;
    bool is_answered = false;
};

class Peer {
public:
    Peer(uint32_t domain_id, const std::string& enclave) {
        fast::DomainParticipantQos qos;
        qos.transport().use_builtin_transports = false;
        auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
        udp->interfaceWhiteList.push_back("127.0.0.1");
        udp->maxInitialPeersRange = 32;
        qos.transport().user_transports.push_back(udp);
        rtps::Locator_t loopback;
        rtps::IPLocator::setIPv4(loopback, "127.0.0.1");
        qos.wire_protocol().builtin.initialPeersList.push_back(loopback);
        if (enclave != "-") secure(qos.properties().properties(), "file://" + enclave + "/");
        participant = fast::DomainParticipantFactory::get_instance()->create_participant(domain_id, qos);
        if (participant == nullptr) throw std::runtime_error("cannot create the participant of " + enclave);
        publisher = participant->create_publisher(fast::PUBLISHER_QOS_DEFAULT);
        subscriber = participant->create_subscriber(fast::SUBSCRIBER_QOS_DEFAULT);
    }

    ~Peer() {
        if (participant == nullptr) return;
        participant->delete_contained_entities();
        fast::DomainParticipantFactory::get_instance()->delete_participant(participant);
    }

    void start(Command& command) {
        const std::string& kind = command.kind;
        const bool is_reader = kind == "subscribe" || kind == "recall";
        if (is_reader || kind == "publish" || kind == "fill" || kind == "keep") {
            auto* topic = make_topic("rt" + command.name, "std_msgs::msg::dds_::String_");
            const auto durability = kind == "keep" || kind == "recall" ? fast::TRANSIENT_LOCAL_DURABILITY_QOS : fast::VOLATILE_DURABILITY_QOS;
            if (is_reader) command.reader = make_reader(topic, durability);
            else command.writer = make_writer(topic, durability);
            return;
        }
        const bool is_list = kind == "list", is_client = is_list || kind == "call";
        const std::string service = command.name + (is_list ? "/list_parameters" : "");
        const std::string type = is_list ? "rcl_interfaces::srv::dds_::ListParameters" : "std_srvs::srv::dds_::SetBool";
        auto* requests = make_topic("rq" + service + "Request", type + "_Request_");
        auto* responses = make_topic("rr" + service + "Reply", type + "_Response_");
        command.writer = make_writer(is_client ? requests : responses);
        command.reader = make_reader(is_client ? responses : requests);
    }

private:
    static void secure(rtps::PropertySeq& properties, const std::string& folder) {
        const std::string auth = "dds.sec.auth.builtin.PKI-DH.", access = "dds.sec.access.builtin.Access-Permissions.";
        properties.emplace_back("dds.sec.auth.plugin", "builtin.PKI-DH");
        properties.emplace_back(auth + "identity_ca", folder + "identity_ca.cert.pem");
        properties.emplace_back(auth + "identity_certificate", folder + "cert.pem");
        properties.emplace_back(auth + "private_key", folder + "key.pem");
        properties.emplace_back("dds.sec.crypto.plugin", "builtin.AES-GCM-GMAC");
        properties.emplace_back("dds.sec.access.plugin", "builtin.Access-Permissions");
        properties.emplace_back(access + "permissions_ca", folder + "permissions_ca.cert.pem");
        properties.emplace_back(access + "governance", folder + "governance.p7s");
        properties.emplace_back(access + "permissions", folder + "permissions.p7s");
    }

    fast::Topic* make_topic(const std::string& name, const std::string& type) {
        fast::TypeSupport(new Encoded(type)).register_type(participant);
        auto* topic = participant->create_topic(name, type, fast::TOPIC_QOS_DEFAULT);
        if (topic == nullptr) throw std::runtime_error("cannot create the topic " + name);
        return topic;
    }

    fast::DataWriter* make_writer(fast::Topic* topic, fast::DurabilityQosPolicyKind durability = fast::VOLATILE_DURABILITY_QOS) {
        fast::DataWriterQos qos;
        qos.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
        qos.durability().kind = durability;
        qos.history().depth = 10;
        qos.endpoint().history_memory_policy = rtps::DYNAMIC_REUSABLE_MEMORY_MODE;
        qos.publish_mode().kind = fast::ASYNCHRONOUS_PUBLISH_MODE;
        auto* writer = publisher->create_datawriter(topic, qos);
        if (writer == nullptr) throw std::runtime_error("cannot create the writer of " + topic->get_name());
        return writer;
    }

    fast::DataReader* make_reader(fast::Topic* topic, fast::DurabilityQosPolicyKind durability = fast::VOLATILE_DURABILITY_QOS) {
        fast::DataReaderQos qos;
        qos.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
        qos.durability().kind = durability;
        qos.history().depth = 10;
        qos.endpoint().history_memory_policy = rtps::DYNAMIC_REUSABLE_MEMORY_MODE;
        auto* reader = subscriber->create_datareader(topic, qos);
        if (reader == nullptr) throw std::runtime_error("cannot create the reader of " + topic->get_name());
        return reader;
    }

    fast::DomainParticipant* participant = nullptr;
    fast::Publisher* publisher = nullptr;
    fast::Subscriber* subscriber = nullptr;
};

void receive(Command& command) {
    Bytes sample;
    fast::SampleInfo info;
    while (command.reader != nullptr && command.reader->take_next_sample(&sample, &info) == ReturnCode_t::RETCODE_OK) {
        if (!info.valid_data) continue;
        if (command.kind == "subscribe" || command.kind == "recall") {
            std::cout << "heard " << command.name << " " << text_at(sample, 4) << std::endl;
        } else if (command.kind == "serve") {
            const bool data = sample.size() > 4 && sample[4] != 0;
            std::cout << "served " << command.name << (data ? " true" : " false") << std::endl;
            Bytes response = encapsulated();
            response.push_back(data);
            put(response, data ? "data is true" : "data is false");
            rtps::WriteParams about;
            about.related_sample_identity(info.sample_identity);
            command.writer->write(&response, about);
        } else if (!command.is_answered && info.related_sample_identity.writer_guid() == command.writer->guid()) {
            if (command.kind == "list") std::cout << "listed " << command.name << texts(sample) << std::endl;
            else std::cout << "answered " << command.name << " " << text_at(sample, 8) << std::endl;
            command.is_answered = true;
        }
    }
}

void send(Command& command, int64_t tick) {
    Bytes sample = encapsulated();
    if (command.kind == "publish") {
        put(sample, command.text + " " + std::to_string(++command.count));
        command.writer->write(&sample);
    } else if (command.kind == "fill" && tick % 10 == 0) {
        put(sample, std::string(std::stoul(command.text), 'x') + " " + std::to_string(++command.count));
        command.writer->write(&sample);
    } else if (command.kind == "keep" && tick == 0) {
        put(sample, command.text);
        command.writer->write(&sample);
    } else if (command.kind == "list" && !command.is_answered && tick % 10 == 0) {
        sample.resize(20); // no prefixes, and a depth of 0 at the next multiple of 8
        command.writer->write(&sample);
    } else if (command.kind == "call" && !command.is_answered && tick % 10 == 0) {
        sample.push_back(command.text == "true");
        command.writer->write(&sample);
    }
}

void log_to_standard_error() {
    auto consumer = std::make_unique<fast::StdoutErrConsumer>();
    consumer->stderr_threshold(fast::Log::Info);
    fast::Log::ClearConsumers();
    fast::Log::RegisterConsumer(std::move(consumer));
    fast::Log::SetVerbosity(fast::Log::Warning);
}

std::vector<Command> parse(int count, char** arguments) {
    std::vector<Command> commands;
    for (int at = 3; at < count;) {
        Command command;
        command.kind = arguments[at];
        static const std::map<std::string, int> kinds = {{"publish", 3}, {"subscribe", 2}, {"serve", 2}, {"call", 3},
                                                         {"fill", 3},    {"keep", 3},      {"recall", 2}, {"list", 2}};
        const auto known = kinds.find(command.kind);
        if (known == kinds.end() || count - at < known->second) return {};
        const int size = known->second;
        command.name = arguments[at + 1];
        if (size == 3) command.text = arguments[at + 2];
        commands.push_back(command);
        at += size;
    }
    return commands;
}

int main(int count, char** arguments) try {
    auto commands = parse(count, arguments);
    if (commands.empty()) {
        std::cerr << "usage: " << arguments[0]
                  << " DOMAIN_ID ENCLAVE COMMAND..., see the head of its source" << std::endl;
        return 2;
    }
    log_to_standard_error();
    Peer peer(static_cast<uint32_t>(std::stoul(arguments[1])), arguments[2]);
    for (auto& command : commands) peer.start(command);
    std::cout << "ready" << std::endl;

    pollfd input{STDIN_FILENO, POLLIN, 0};
    char ignored[256];
    for (int64_t tick = 0;; tick++) {
        for (auto& command : commands) {
            receive(command);
            send(command, tick);
        }
        if (poll(&input, 1, 100) > 0 && read(STDIN_FILENO, ignored, sizeof ignored) <= 0) break;
    }
    return 0;
} catch (const std::exception& error) {
    std::cerr << "peer: " << error.what() << std::endl;
    return 1;
}
