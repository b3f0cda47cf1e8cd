// A participant of Fast DDS, with or without DDS Security, for the tests of this package.
//
// usage: peer DOMAIN_ID ENCLAVE COMMAND...
//   ENCLAVE                the folder of the six files of sros2, or - for a participant without security
//   publish TOPIC TEXT     publishes "TEXT 1", "TEXT 2", … ten times a second (std_msgs/msg/String)
//   subscribe TOPIC        prints each sample
//   serve SERVICE          answers requests (std_srvs/srv/SetBool)
//   call SERVICE DATA      sends a request each second until the response arrives; DATA is true or false
// TOPIC and SERVICE are names of ROS 2 with their leading slash. The program ends when its standard input does.
//
// It prints one line for each event: "ready", "heard TOPIC TEXT", "served SERVICE DATA", "answered SERVICE MESSAGE".
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
        m_typeSize = 1 << 20;
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

/// The string at `offset`, which is the last field of each type here.
std::string text_at(const Bytes& bytes, size_t offset) {
    if (bytes.size() < offset + 5) return "(too short)";
    uint32_t size = 0;
    for (int at = 0; at < 4; at++) size |= static_cast<uint32_t>(bytes[offset + at]) << (8 * at);
    if (size == 0 || size > bytes.size() - offset - 4) return "(wrong length)";
    return std::string(reinterpret_cast<const char*>(&bytes[offset + 4]), size - 1);
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
        if (command.kind == "publish" || command.kind == "subscribe") {
            auto* topic = make_topic("rt" + command.name, "std_msgs::msg::dds_::String_");
            if (command.kind == "publish") command.writer = make_writer(topic);
            else command.reader = make_reader(topic);
            return;
        }
        auto* requests = make_topic("rq" + command.name + "Request", "std_srvs::srv::dds_::SetBool_Request_");
        auto* responses = make_topic("rr" + command.name + "Reply", "std_srvs::srv::dds_::SetBool_Response_");
        const bool is_client = command.kind == "call";
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

    fast::DataWriter* make_writer(fast::Topic* topic) {
        fast::DataWriterQos qos;
        qos.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
        qos.durability().kind = fast::VOLATILE_DURABILITY_QOS;
        qos.history().depth = 10;
        qos.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
        qos.publish_mode().kind = fast::ASYNCHRONOUS_PUBLISH_MODE;
        auto* writer = publisher->create_datawriter(topic, qos);
        if (writer == nullptr) throw std::runtime_error("cannot create the writer of " + topic->get_name());
        return writer;
    }

    fast::DataReader* make_reader(fast::Topic* topic) {
        fast::DataReaderQos qos;
        qos.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
        qos.durability().kind = fast::VOLATILE_DURABILITY_QOS;
        qos.history().depth = 10;
        qos.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
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
        if (command.kind == "subscribe") {
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
            std::cout << "answered " << command.name << " " << text_at(sample, 8) << std::endl;
            command.is_answered = true;
        }
    }
}

void send(Command& command, int64_t tick) {
    Bytes sample = encapsulated();
    if (command.kind == "publish") {
        put(sample, command.text + " " + std::to_string(++command.count));
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
        const int size = command.kind == "publish" || command.kind == "call" ? 3 : 2;
        const bool is_known = size == 3 || command.kind == "subscribe" || command.kind == "serve";
        if (!is_known || count - at < size) return {};
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
                  << " DOMAIN_ID ENCLAVE (publish TOPIC TEXT|subscribe TOPIC|serve SERVICE|call SERVICE DATA)..." << std::endl;
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
