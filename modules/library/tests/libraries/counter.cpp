// Counts over its versions, serves and calls, and fails on request.
#include <csignal>
#include <cstdlib>

#include "downbeat.hpp"
#include "std_msgs/msg/float64.hpp"
#include "std_srvs/srv/set_bool.hpp"

using std_msgs::msg::Float64;
using std_srvs::srv::SetBool;
using namespace std::chrono_literals;

#ifndef VERSION
#define VERSION 1
#endif

class Counter : public downbeat::Module {
    void setup() override {
        auto out = publish<Float64>("count");
        auto version = publish<Float64>("version");
        step_ = setting("step", 1.0, "what one tick adds", 0.0, 100.0);
        label_ = setting("label", "none", "any text but an empty one");
        flags_ = setting("flags", std::vector<bool>{true, false}, "two flags");
        accept_if<std::string>(label_, [](const std::string &text) {
            if (text.empty()) {
                throw downbeat::Error("a label has a letter");
            }
        });
        on_change(label_, [this] { info("the label is " + *label_); });
        every(10ms, [this, out, version] {
            if (!std::vector<bool>(*flags_).at(0)) {
                return;
            }
            info_every(100ms, "counts");
            warn_once("began");
            count_ += *step_;
            out({count_});
            version({VERSION});
        });
        subscribe<Float64>("fail", [](const Float64 &message, const downbeat::Received &received) {
            if (!received.is_last) {
                return;
            }
            if (message.data == 1) {
                throw std::out_of_range("there is no joint 21");
            }
            if (message.data == 2) {
                throw 2;
            }
            if (message.data == 3) {
                std::raise(SIGKILL);
            }
            if (message.data == 5) {
                for (volatile bool endless = true; endless;) {
                }
            }
            if (message.data == 4) {
                std::abort();
            }
        });
        serve<SetBool>("enable", [](const SetBool::Request &request) {
            if (!request.data) {
                throw downbeat::Error("it stays on");
            }
            return SetBool::Response{true, "on"};
        });
        auto answers = publish<Float64>("answers");
        client_ = client<SetBool>("other", 1s, [answers](const downbeat::Reply<SetBool::Response> &reply) {
            answers({reply ? 1.0 : reply.error.find("stays on") != std::string::npos ? -1.0 : -2.0});
        });
        task_ = task([this] {
            client_({true});
            client_({false});
        });
        subscribe<Float64>("ask", [this](const Float64 &) { task_.after(10ms); });
#ifdef MISTAKE
        throw downbeat::Error("this version has a mistake");
#endif
    }

    std::vector<std::uint8_t> save() override { return downbeat::cdr::encode(Float64{count_}); }
    void restore(const std::vector<std::uint8_t> &state) override {
        count_ = downbeat::cdr::decode<Float64>(state.data(), state.size()).data;
    }

    void variables(downbeat::Variables &variables) const override {
        enum class Color { red, green };
        variables.report("count", count_);
        variables.report("is_on", true);
        variables.report("small", std::uint8_t{7});
        variables.report("large", UINT64_MAX);
        variables.report("color", Color::green);
        variables.report("text", std::string("two\nlines"));
        variables.report("literal", "letters");
        variables.report("bytes", std::vector<std::uint8_t>{1, 2});
        variables.report("floats", std::array<float, 2>{0.5f, 1});
        variables.report("numbers", std::vector<int>{-1, 2});
        variables.report("flags", std::vector<bool>{true, false});
        variables.report("names", std::vector<std::string>{"left", "right"});
        variables.report("none", std::vector<double>{});
#ifdef MISTAKE_OF_VARIABLES
        throw std::out_of_range("there is no joint 21");
#endif
#ifdef SETTING_OF_VARIABLES
        variables.report("step", *step_);
#endif
#ifdef ENDLESS_VARIABLES
        for (volatile bool endless = true; endless;) {
        }
#endif
    }

    double count_ = 0;
    downbeat::Setting<double> step_;
    downbeat::Setting<std::string> label_;
    downbeat::Setting<std::vector<bool>> flags_;
    downbeat::Client<SetBool> client_;
    downbeat::Task task_;
};

DOWNBEAT_MODULE(Counter)
