// downbeat.hpp: modules of downbeat robots in C++17, as shared libraries.
//
//     #include "downbeat.hpp"
//     #include "std_msgs/msg/float64.hpp" // from: downbeat interface generate --lang cpp std_msgs/msg/Float64
//
//     class Doubler : public downbeat::Module {
//         void setup() override {
//             auto out = publish<std_msgs::msg::Float64>("out");
//             subscribe<std_msgs::msg::Float64>("in", [out](const auto &message) { out({message.data * 2}); });
//         }
//     };
//     DOWNBEAT_MODULE(Doubler)
//
// An exception that leaves a callback ends the module, and never the robot.
#ifndef DOWNBEAT_HPP
#define DOWNBEAT_HPP

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdint>
#include <cstring>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "downbeat.h"

namespace downbeat {

// Why something fails. Thrown by the callback of a service, it is sent to the client as the reason.
class Error : public std::runtime_error {
  public:
    using std::runtime_error::runtime_error;
};

// What the generator writes for each message: name, hash, encode, decode. For services: name and hash.
template <class T> struct Interface;

namespace cdr {

inline bool is_little_endian() {
    const std::uint16_t one = 1;
    std::uint8_t first;
    std::memcpy(&first, &one, 1);
    return first == 1;
}

// Writes a value in CDR, in the byte order of the machine.
class Writer {
  public:
    Writer() { start(); }

    // Starts a value; the memory of the value before is used again.
    void start() { bytes_.assign({0, static_cast<std::uint8_t>(is_little_endian() ? 1 : 0), 0, 0}); }
    const std::vector<std::uint8_t> &bytes() const { return bytes_; }

    template <class T> void put(const T &value) {
        if constexpr (std::is_same_v<T, bool>) {
            bytes_.push_back(value ? 1 : 0);
        } else if constexpr (std::is_arithmetic_v<T>) {
            numbers(&value, 1);
        } else {
            Interface<T>::encode(*this, value);
        }
    }

    void put(const std::string &text) {
        put(static_cast<std::uint32_t>(text.size() + 1));
        append(text.c_str(), text.size() + 1);
    }

    void put(const std::u16string &text) {
        put(static_cast<std::uint32_t>(text.size()));
        for (char16_t unit : text) {
            put(static_cast<std::uint32_t>(unit));
        }
    }

    template <class T, std::size_t N> void put(const std::array<T, N> &values) { elements(values); }

    template <class T> void put(const std::vector<T> &values) {
        put(static_cast<std::uint32_t>(values.size()));
        elements(values);
    }

    // Checks the bound of a sequence or a string.
    static void check(const char *field, std::size_t size, std::size_t bound) {
        if (size > bound) {
            throw Error(std::string(field) + " has " + std::to_string(size) + " elements, at most " + std::to_string(bound) +
                        " are allowed");
        }
    }

  private:
    void append(const void *bytes, std::size_t size) {
        const auto *first = static_cast<const std::uint8_t *>(bytes);
        bytes_.insert(bytes_.end(), first, first + size);
    }

    template <class T> void numbers(const T *values, std::size_t count) {
        if (count > 0) {
            bytes_.resize(bytes_.size() + (sizeof(T) - (bytes_.size() - 4) % sizeof(T)) % sizeof(T));
            append(values, sizeof(T) * count);
        }
    }

    template <class Values> void elements(const Values &values) {
        using T = typename Values::value_type;
        if constexpr (std::is_arithmetic_v<T> && !std::is_same_v<T, bool>) {
            numbers(values.data(), values.size());
        } else {
            for (const T &value : values) {
                put(value);
            }
        }
    }

    std::vector<std::uint8_t> bytes_;
};

// Reads a value in CDR of both byte orders. Throws Error if the bytes are no such value.
class Reader {
  public:
    Reader(const std::uint8_t *bytes, std::size_t size) {
        if (size < 4 || bytes[0] != 0 || bytes[1] > 1) {
            throw Error("the encapsulation header is not that of plain CDR");
        }
        data_ = bytes + 4;
        size_ = size - 4;
        is_swapped_ = (bytes[1] == 1) != is_little_endian();
    }

    template <class T> void get(T &value) {
        if constexpr (std::is_same_v<T, bool>) {
            std::uint8_t byte = *take(1, 1);
            if (byte > 1) {
                throw Error("a bool is neither 0 nor 1");
            }
            value = byte == 1;
        } else if constexpr (std::is_arithmetic_v<T>) {
            numbers(&value, 1);
        } else {
            Interface<T>::decode(*this, value);
        }
    }

    void get(std::string &text) {
        std::uint32_t size = 0;
        get(size);
        const auto *bytes = reinterpret_cast<const char *>(take(1, size));
        // Some senders leave out the terminating zero of an empty string.
        text.assign(bytes, size > 0 && bytes[size - 1] == 0 ? size - 1 : size);
    }

    void get(std::u16string &text) {
        text.resize(count(4));
        for (char16_t &unit : text) {
            std::uint32_t wide = 0;
            get(wide);
            unit = static_cast<char16_t>(wide);
        }
    }

    template <class T, std::size_t N> void get(std::array<T, N> &values) { elements(values); }

    template <class T> void get(std::vector<T> &values) {
        values.resize(count(1));
        elements(values);
    }

  private:
    const std::uint8_t *take(std::size_t alignment, std::size_t size) {
        std::size_t padding = (alignment - position_ % alignment) % alignment;
        std::size_t left = size_ - position_;
        if (left < padding || left - padding < size) {
            throw Error("the message ends before its last field");
        }
        const std::uint8_t *bytes = data_ + position_ + padding;
        position_ += padding + size;
        return bytes;
    }

    std::size_t count(std::size_t least) {
        std::uint32_t count = 0;
        get(count);
        if (count > (size_ - position_) / least) {
            throw Error("a sequence is longer than the message");
        }
        return count;
    }

    template <class T> void numbers(T *values, std::size_t count) {
        if (count == 0) {
            return;
        }
        const std::uint8_t *bytes = take(sizeof(T), sizeof(T) * count);
        if (!is_swapped_ || sizeof(T) == 1) {
            std::memcpy(values, bytes, sizeof(T) * count);
            return;
        }
        for (std::size_t index = 0; index < count; index++) {
            std::uint8_t swapped[sizeof(T)];
            for (std::size_t byte = 0; byte < sizeof(T); byte++) {
                swapped[byte] = bytes[index * sizeof(T) + sizeof(T) - 1 - byte];
            }
            std::memcpy(values + index, swapped, sizeof(T));
        }
    }

    template <class Values> void elements(Values &values) {
        using T = typename Values::value_type;
        if constexpr (std::is_same_v<Values, std::vector<bool>>) {
            for (std::size_t index = 0; index < values.size(); index++) {
                bool value = false;
                get(value);
                values[index] = value;
            }
        } else if constexpr (std::is_arithmetic_v<T> && !std::is_same_v<T, bool>) {
            numbers(values.data(), values.size());
        } else {
            for (T &value : values) {
                get(value);
            }
        }
    }

    const std::uint8_t *data_ = nullptr;
    std::size_t size_ = 0;
    std::size_t position_ = 0;
    bool is_swapped_ = false;
};

// A value in CDR.
template <class T> std::vector<std::uint8_t> encode(const T &value) {
    Writer writer;
    writer.put(value);
    return writer.bytes();
}

// The value of these bytes. Throws Error if they are no such value.
template <class T> T decode(const std::uint8_t *bytes, std::size_t size) {
    Reader reader(bytes, size);
    T value;
    reader.get(value);
    return value;
}

} // namespace cdr

// About a received message.
struct Received {
    std::chrono::nanoseconds time; // of the cycle that published it
    std::uint32_t missed;          // how many messages before it the bounded inbox dropped
    bool is_last;                  // whether the topic carried no message after it in that cycle
};

// The end of a call.
template <class T> struct Reply {
    std::uint64_t call;        // as Client returned it
    std::optional<T> response; // empty if the call failed
    std::string error;         // why it failed
    explicit operator bool() const { return response.has_value(); }
};

class Module;

namespace detail {

// The program has recorded why.
struct Refused {};

inline void check(std::int32_t code) {
    if (code != 0) {
        throw Refused();
    }
}

// Gives the robot the definition of a type that it may not know.
template <class T, class = void> struct Carried {
    static void define(const downbeat_host_v1 *) {}
};
template <class T> struct Carried<T, std::void_t<decltype(Interface<T>::whole)>> {
    static void define(const downbeat_host_v1 *host) {
        check(downbeat_define(host, Interface<T>::whole, Interface<T>::definition()));
    }
};

// The value of a setting in the form of C, and back.
template <class T> struct Value;
template <class T, std::uint32_t Kind> struct Number {
    static T from_c(const downbeat_value_v1 &value) {
        T number;
        std::memcpy(&number, value.data, sizeof number);
        return number;
    }
    template <class F> static auto in_c(const T &value, F use) {
        downbeat_value_v1 given = {DOWNBEAT_ABI_VERSION, sizeof given, Kind, 0, &value, 1};
        return use(given);
    }
};
template <class T, std::uint32_t Kind> struct List {
    static std::vector<T> from_c(const downbeat_value_v1 &value) {
        const T *first = static_cast<const T *>(value.data);
        return std::vector<T>(first, first + value.count);
    }
    template <class F> static auto in_c(const std::vector<T> &values, F use) {
        downbeat_value_v1 given = {DOWNBEAT_ABI_VERSION, sizeof given, Kind, 0, values.data(), values.size()};
        return use(given);
    }
};
template <> struct Value<std::int64_t> : Number<std::int64_t, DOWNBEAT_INTEGER> {};
template <> struct Value<double> : Number<double, DOWNBEAT_DOUBLE> {};
template <> struct Value<bool> {
    static bool from_c(const downbeat_value_v1 &value) { return *static_cast<const std::uint8_t *>(value.data) != 0; }
    template <class F> static auto in_c(bool value, F use) {
        std::uint8_t byte = value ? 1 : 0;
        downbeat_value_v1 given = {DOWNBEAT_ABI_VERSION, sizeof given, DOWNBEAT_BOOL, 0, &byte, 1};
        return use(given);
    }
};
template <> struct Value<std::string> {
    static std::string from_c(const downbeat_value_v1 &value) { return {static_cast<const char *>(value.data), value.count}; }
    template <class F> static auto in_c(const std::string &text, F use) {
        downbeat_value_v1 given = {DOWNBEAT_ABI_VERSION, sizeof given, DOWNBEAT_TEXT, 0, text.data(), text.size()};
        return use(given);
    }
};
template <> struct Value<std::vector<std::uint8_t>> : List<std::uint8_t, DOWNBEAT_BYTES> {};
template <> struct Value<std::vector<std::int64_t>> : List<std::int64_t, DOWNBEAT_INTEGERS> {};
template <> struct Value<std::vector<double>> : List<double, DOWNBEAT_DOUBLES> {};
template <> struct Value<std::vector<bool>> {
    static std::vector<bool> from_c(const downbeat_value_v1 &value) {
        const auto *first = static_cast<const std::uint8_t *>(value.data);
        std::vector<bool> values(value.count);
        for (std::size_t index = 0; index < value.count; index++) {
            values[index] = first[index] != 0;
        }
        return values;
    }
    template <class F> static auto in_c(const std::vector<bool> &values, F use) {
        std::vector<std::uint8_t> bytes(values.begin(), values.end());
        downbeat_value_v1 given = {DOWNBEAT_ABI_VERSION, sizeof given, DOWNBEAT_BOOLS, 0, bytes.data(), bytes.size()};
        return use(given);
    }
};
template <> struct Value<std::vector<std::string>> {
    static std::vector<std::string> from_c(const downbeat_value_v1 &value) {
        const auto *first = static_cast<const char *const *>(value.data);
        return std::vector<std::string>(first, first + value.count);
    }
    template <class F> static auto in_c(const std::vector<std::string> &texts, F use) {
        std::vector<const char *> pointers;
        for (const std::string &text : texts) {
            pointers.push_back(text.c_str());
        }
        downbeat_value_v1 given = {DOWNBEAT_ABI_VERSION, sizeof given, DOWNBEAT_TEXTS, 0, pointers.data(), pointers.size()};
        return use(given);
    }
};

// The kind of setting for an initial value: `1` is an integer, `1.0` a double, `"a"` a text.
template <class T> struct Kept { using type = T; };
template <> struct Kept<int> { using type = std::int64_t; };
template <> struct Kept<float> { using type = double; };
template <> struct Kept<const char *> { using type = std::string; };

template <class Class> struct Table;

} // namespace detail

// Publishes messages on a topic.
template <class T> class Publisher {
  public:
    Publisher() = default;
    void operator()(const T &message) const;

  private:
    friend class Module;
    Publisher(Module *module, std::uint32_t number) : module_(module), number_(number) {}
    Module *module_ = nullptr;
    std::uint32_t number_ = 0;
};

// Calls a service.
template <class S> class Client {
  public:
    Client() = default;
    // Returns the number of the call, which its Reply has.
    std::uint64_t operator()(const typename S::Request &request) const;

  private:
    friend class Module;
    Client(Module *module, std::uint32_t number) : module_(module), number_(number) {}
    Module *module_ = nullptr;
    std::uint32_t number_ = 0;
};

// A setting of the module: a parameter in ROS 2.
template <class T> class Setting {
  public:
    Setting() = default;
    // The value in this cycle.
    T operator*() const;

  private:
    friend class Module;
    Setting(const Module *module, std::uint32_t number) : module_(module), number_(number) {}
    const Module *module_ = nullptr;
    std::uint32_t number_ = 0;
};

// Something that can be scheduled.
class Task {
  public:
    Task() = default;
    // Schedules it once, this long after the time of the cycle.
    void after(std::chrono::nanoseconds delay) const;
    void cancel() const;

  private:
    friend class Module;
    Task(const Module *module, std::uint32_t number) : module_(module), number_(number) {}
    const Module *module_ = nullptr;
    std::uint32_t number_ = 0;
};

// A request that is answered later.
template <class S> class Request {
  public:
    void reply(const typename S::Response &response) const;
    void refuse(const std::string &reason) const;

  private:
    friend class Module;
    Request(Module *module, std::uint64_t id) : module_(module), id_(id) {}
    Module *module_;
    std::uint64_t id_;
};

// A place in the source: that of the call whose default argument it is.
class Place {
  public:
    explicit Place(const char *file = __builtin_FILE(), int line = __builtin_LINE(), const char *function = __builtin_FUNCTION())
        : file_(file), line_(line), function_(function) {}
    const char *file() const { return file_; }
    int line() const { return line_; }
    const char *function() const { return function_; }
    bool operator<(const Place &other) const {
        return line_ != other.line_ ? line_ < other.line_ : std::strcmp(file_, other.file_) < 0;
    }

  private:
    const char *file_;
    int line_;
    const char *function_;
};

// Takes the variables of a module for the debugger.
class Variables {
  public:
    // The value is a bool, a number, an enum or a text, or a vector or an array of these.
    template <class T> void report(const std::string &name, const T &value) {
        if constexpr (std::is_integral_v<T> && std::is_unsigned_v<T> && sizeof(T) >= sizeof(std::int64_t)) {
            if (value > static_cast<T>(INT64_MAX)) {
                return report(name, std::to_string(value));
            }
        }
        using Kept = std::decay_t<decltype(kept(value))>;
        detail::check(detail::Value<Kept>::in_c(kept(value), [&](const downbeat_value_v1 &given) {
            return host_->variable(host_, name.c_str(), &given);
        }));
    }

  private:
    template <class> friend struct detail::Table;
    explicit Variables(const downbeat_host_v1 *host) : host_(host) {}

    template <class> static constexpr bool is_known = false;

    // The value as one of the kinds of the C interface.
    template <class T> static auto kept(const T &value) {
        if constexpr (std::is_same_v<T, bool>) {
            return value;
        } else if constexpr (std::is_integral_v<T> || std::is_enum_v<T>) {
            return static_cast<std::int64_t>(value);
        } else if constexpr (std::is_floating_point_v<T>) {
            return static_cast<double>(value);
        } else if constexpr (std::is_convertible_v<const T &, std::string_view>) {
            return std::string(std::string_view(value));
        } else {
            static_assert(is_known<T>, "report takes bools, numbers, enums and texts, and vectors and arrays of these");
        }
    }
    // Bytes are numbers too; as DOWNBEAT_BYTES they need no copy of eight times their size.
    static const std::vector<std::uint8_t> &kept(const std::vector<std::uint8_t> &bytes) { return bytes; }
    template <class T, class Allocator> static auto kept(const std::vector<T, Allocator> &values) { return all<T>(values); }
    template <class T, std::size_t N> static auto kept(const std::array<T, N> &values) { return all<T>(values); }
    template <class T, class Values> static auto all(const Values &values) {
        std::vector<std::decay_t<decltype(kept(std::declval<const T &>()))>> all;
        all.reserve(values.size());
        for (const T &value : values) {
            all.push_back(kept(value));
        }
        return all;
    }

    const downbeat_host_v1 *host_;
};

// Where a goal of an action stands: the values of action_msgs/msg/GoalStatus.
enum class GoalStatus : std::int8_t { unknown, accepted, executing, canceling, succeeded, canceled, aborted };

using GoalId = std::array<std::uint8_t, 16>;

namespace detail {

template <class T> void set_time(T &time, std::chrono::nanoseconds since) {
    const auto seconds = std::chrono::floor<std::chrono::seconds>(since);
    time.sec = static_cast<std::int32_t>(seconds.count());
    time.nanosec = static_cast<std::uint32_t>((since - seconds).count());
}
template <class T> std::chrono::nanoseconds time_of(const T &time) {
    return std::chrono::seconds(time.sec) + std::chrono::nanoseconds(time.nanosec);
}

template <class A> struct ActionState;

template <class A> struct GoalState {
    GoalId id;
    std::chrono::nanoseconds stamp, ended;
    typename A::Goal request;
    typename A::Result result;
    GoalStatus status;
    std::vector<Request<typename A::GetResult>> waiting;

    bool has_ended() const { return status >= GoalStatus::succeeded; }
};

} // namespace detail

// A goal of an action that the module serves. Keep it to go on in later callbacks; it ends with `succeed`, `abort` or `canceled`.
template <class A> class Goal {
  public:
    const typename A::Goal &request() const { return goal_->request; }
    GoalStatus status() const { return goal_->status; }
    // Whether a client asks to cancel it.
    bool is_canceling() const { return goal_->status == GoalStatus::canceling; }
    void feedback(const typename A::Feedback &feedback) const { action_->publish_feedback(*goal_, feedback); }
    void succeed(const typename A::Result &result) const { action_->end(*goal_, GoalStatus::succeeded, result); }
    void abort(const typename A::Result &result) const { action_->end(*goal_, GoalStatus::aborted, result); }
    void canceled(const typename A::Result &result) const { action_->end(*goal_, GoalStatus::canceled, result); }

  private:
    friend struct detail::ActionState<A>;
    Goal(std::shared_ptr<detail::GoalState<A>> goal, detail::ActionState<A> *action) : goal_(std::move(goal)), action_(action) {}
    std::shared_ptr<detail::GoalState<A>> goal_;
    detail::ActionState<A> *action_; // lives as long as the module
};

// The end of a goal that the module has sent.
template <class A> struct GoalEnd {
    GoalId id;
    GoalStatus status;                         // `unknown` if there is no result
    std::optional<typename A::Result> result;
    std::string error;                         // why there is none
};

namespace detail {
template <class A> struct ActionClientState;
} // namespace detail

// Sends goals to an action.
template <class A> class ActionClient {
  public:
    ActionClient() = default;
    // `then` is called once; `feedback` until then.
    GoalId send(const typename A::Goal &goal, std::function<void(const GoalEnd<A> &)> then,
                std::function<void(const typename A::Feedback &)> feedback = {}) const {
        return state_->send(goal, std::move(then), std::move(feedback));
    }
    void cancel(const GoalId &goal) const { state_->cancel(goal); }

  private:
    friend class Module;
    explicit ActionClient(std::shared_ptr<detail::ActionClientState<A>> state) : state_(std::move(state)) {}
    std::shared_ptr<detail::ActionClientState<A>> state_;
};

// A module. Ports and settings are declared in `setup`; what a callback requests takes effect after the cycle.
class Module {
  public:
    Module() = default;
    Module(const Module &) = delete;
    Module &operator=(const Module &) = delete;
    virtual ~Module() = default;

    virtual void setup() = 0;

    // Transitions of the lifecycle. An exception keeps the module in its state.
    virtual void configure() {}
    virtual void activate() {}
    virtual void deactivate() {}
    virtual void cleanup() {}
    virtual void shutdown() {}

    // The state for a changed library that takes over, and back. An exception keeps the version that runs.
    virtual std::vector<std::uint8_t> save() { return {}; }
    virtual void restore(const std::vector<std::uint8_t> &) {}

    // Reports variables for `downbeat bag debug`, such as variables.report("count", count_). Settings are shown anyway; `now()` is the
    // time of the last callback.
    virtual void variables(Variables &) const {}

  protected:
    // The name of the module in the robot.
    std::string name() const { return host_->name(host_); }
    // The time of the cycle: the only clock that a module may use.
    std::chrono::nanoseconds now() const { return std::chrono::nanoseconds(host_->now(host_)); }

    void debug(const std::string &text, Place place = Place()) const { log(DOWNBEAT_DEBUG, text, place); }
    void info(const std::string &text, Place place = Place()) const { log(DOWNBEAT_INFO, text, place); }
    void warn(const std::string &text, Place place = Place()) const { log(DOWNBEAT_WARN, text, place); }
    void error(const std::string &text, Place place = Place()) const { log(DOWNBEAT_ERROR, text, place); }

    // A line that is written at most once per period, with a count of those left out; and one that is written once. The place in
    // the source tells lines apart, and is on /rosout: leave `place` as it is.
    void debug_every(std::chrono::nanoseconds period, const std::string &text, Place place = Place()) const {
        log_limited(DOWNBEAT_DEBUG, period.count(), text, place);
    }
    void info_every(std::chrono::nanoseconds period, const std::string &text, Place place = Place()) const {
        log_limited(DOWNBEAT_INFO, period.count(), text, place);
    }
    void warn_every(std::chrono::nanoseconds period, const std::string &text, Place place = Place()) const {
        log_limited(DOWNBEAT_WARN, period.count(), text, place);
    }
    void error_every(std::chrono::nanoseconds period, const std::string &text, Place place = Place()) const {
        log_limited(DOWNBEAT_ERROR, period.count(), text, place);
    }
    void debug_once(const std::string &text, Place place = Place()) const { log_limited(DOWNBEAT_DEBUG, -1, text, place); }
    void info_once(const std::string &text, Place place = Place()) const { log_limited(DOWNBEAT_INFO, -1, text, place); }
    void warn_once(const std::string &text, Place place = Place()) const { log_limited(DOWNBEAT_WARN, -1, text, place); }
    void error_once(const std::string &text, Place place = Place()) const { log_limited(DOWNBEAT_ERROR, -1, text, place); }

    template <class T> Publisher<T> publish(const std::string &topic) {
        std::uint32_t number = 0;
        detail::Carried<T>::define(host_);
        detail::check(host_->publisher(host_, topic.c_str(), Interface<T>::name, Interface<T>::hash, &number));
        return {this, number};
    }

    // `callback` takes a message, or a message and a Received.
    template <class T, class F> void subscribe(const std::string &topic, F callback) {
        detail::Carried<T>::define(host_);
        detail::check(host_->subscription(host_, topic.c_str(), Interface<T>::name, Interface<T>::hash, nullptr));
        subscriptions_.push_back([callback, message = T()](const downbeat_event_v1 &event) mutable {
            cdr::Reader(event.data, event.size).get(message);
            if constexpr (std::is_invocable_v<F, const T &, const Received &>) {
                callback(message, Received{std::chrono::nanoseconds(event.time_ns), event.missed, event.is_last != 0});
            } else {
                callback(message);
            }
        });
    }

    // `callback` takes a request and returns the response. An Error is sent to the client.
    template <class S, class F> void serve(const std::string &service, F callback) {
        serve_later<S>(service, [callback](const typename S::Request &request, const Request<S> &open) mutable {
            open.reply(callback(request));
        });
    }

    // `callback` takes a request and a Request<S>, to be answered now or later. An Error is sent to the client.
    template <class S, class F> void serve_later(const std::string &service, F callback) {
        detail::Carried<S>::define(host_);
        detail::check(host_->server(host_, service.c_str(), Interface<S>::name, Interface<S>::hash, nullptr));
        servers_.push_back([this, callback](const downbeat_event_v1 &event) mutable {
            const Request<S> open(this, event.id);
            try {
                callback(cdr::decode<typename S::Request>(event.data, event.size), open);
            } catch (const Error &error) {
                open.refuse(error.what());
            }
        });
    }

    // `callback` takes a Reply<S::Response>, after `timeout` at the latest.
    template <class S, class F> Client<S> client(const std::string &service, std::chrono::nanoseconds timeout, F callback) {
        std::uint32_t number = 0;
        detail::Carried<S>::define(host_);
        detail::check(host_->client(host_, service.c_str(), Interface<S>::name, Interface<S>::hash, timeout.count(), &number));
        clients_.push_back([callback](const downbeat_event_v1 &event) mutable {
            Reply<typename S::Response> reply{event.id, std::nullopt, {}};
            if (event.is_error) {
                reply.error.assign(reinterpret_cast<const char *>(event.data), event.size);
            } else {
                reply.response = cdr::decode<typename S::Response>(event.data, event.size);
            }
            callback(reply);
        });
        return {this, number};
    }

    // Serves an action. `callback` takes a Goal<A>; an Error that it throws refuses the goal.
    template <class A, class F> void act(const std::string &name, F callback) {
        auto state = std::make_shared<detail::ActionState<A>>();
        detail::ActionState<A> *action = state.get();
        action->module = this;
        actions_.push_back(std::move(state));
        serve<typename A::SendGoal>(name + "/_action/send_goal", [action, callback](const typename A::SendGoal::Request &request) mutable {
            return action->take(request, callback);
        });
        serve_later<typename A::GetResult>(name + "/_action/get_result",
                                           [action](const typename A::GetResult::Request &request,
                                                    const Request<typename A::GetResult> &open) { action->ask(request, open); });
        serve<typename A::CancelGoal>(name + "/_action/cancel_goal",
                                      [action](const typename A::CancelGoal::Request &request) { return action->cancel(request); });
        action->feedback = publish<typename A::FeedbackMessage>(name + "/_action/feedback");
        action->status = publish<typename A::GoalStatusArray>(name + "/_action/status");
    }

    // Uses an action. `timeout` is for the acceptance of a goal and for canceling it.
    template <class A> ActionClient<A> action_client(const std::string &name, std::chrono::nanoseconds timeout) {
        auto state = std::make_shared<detail::ActionClientState<A>>();
        detail::ActionClientState<A> *action = state.get();
        action->module = this;
        action->send_goal = client<typename A::SendGoal>(
            name + "/_action/send_goal", timeout,
            [action](const Reply<typename A::SendGoal::Response> &reply) { action->accepted(reply); });
        action->get_result = client<typename A::GetResult>(
            name + "/_action/get_result", std::chrono::hours(24 * 365),
            [action](const Reply<typename A::GetResult::Response> &reply) { action->ended(reply); });
        action->cancel_goal = client<typename A::CancelGoal>(name + "/_action/cancel_goal", timeout,
                                                             [](const Reply<typename A::CancelGoal::Response> &) {});
        subscribe<typename A::FeedbackMessage>(name + "/_action/feedback",
                                               [action](const typename A::FeedbackMessage &message) { action->take(message); });
        actions_.push_back(state);
        return ActionClient<A>(std::move(state));
    }

    void every(std::chrono::nanoseconds period, std::function<void()> callback) {
        detail::check(host_->timer(host_, period.count(), nullptr));
        timers_.push_back(std::move(callback));
    }

    Task task(std::function<void()> callback) {
        std::uint32_t number = 0;
        detail::check(host_->task(host_, &number));
        tasks_.push_back(std::move(callback));
        return {this, number};
    }

    // At the end of each run.
    void each_run(std::function<void()> callback) {
        detail::check(host_->each_run(host_));
        each_run_ = std::move(callback);
    }

    // The description names the purpose and the unit.
    template <class T> auto setting(const std::string &name, T initial, const std::string &description) {
        return declare(name, initial, description, nullptr, false);
    }
    template <class T>
    auto setting(const std::string &name, T initial, const std::string &description, double minimum, double maximum) {
        const double range[2] = {minimum, maximum};
        return declare(name, initial, description, range, false);
    }
    // Does not change after the start.
    template <class T> auto read_only_setting(const std::string &name, T initial, const std::string &description) {
        return declare(name, initial, description, nullptr, true);
    }

    template <class T> void on_change(const Setting<T> &setting, std::function<void()> callback) {
        settings_.at(setting.number_).on_change = std::move(callback);
    }
    // `check` throws to refuse a value.
    template <class T> void accept_if(const Setting<T> &setting, std::function<void(const T &)> check) {
        settings_.at(setting.number_).accept = [check](const downbeat_value_v1 &value) {
            check(detail::Value<T>::from_c(value));
        };
    }

    // Sets a setting of a module, this one or another. What is refused is logged.
    template <class T> void set(const std::string &module, const std::string &setting, const T &value) const {
        using Kept = typename detail::Kept<std::decay_t<T>>::type;
        detail::check(detail::Value<Kept>::in_c(Kept(value), [&](const downbeat_value_v1 &given) {
            return host_->set(host_, module.c_str(), setting.c_str(), &given);
        }));
    }
    // Requests DOWNBEAT_CONFIGURE and so on of a module, this one or another.
    void transition(const std::string &module, std::uint32_t transition) const {
        detail::check(host_->transition(host_, module.c_str(), transition));
    }
    void remove(const std::string &module) const { detail::check(host_->remove(host_, module.c_str())); }

  private:
    template <class> friend class Publisher;
    template <class> friend class Client;
    template <class> friend class Setting;
    template <class> friend class Request;
    template <class> friend struct detail::Table;
    template <class> friend struct detail::ActionState;
    template <class> friend struct detail::ActionClientState;
    friend class Task;

    using Take = std::function<void(const downbeat_event_v1 &)>;
    struct SettingCallbacks {
        std::function<void()> on_change;
        std::function<void(const downbeat_value_v1 &)> accept;
    };

    template <class T>
    auto declare(const std::string &name, const T &initial, const std::string &description, const double *range,
                 bool is_read_only) {
        using Kept = typename detail::Kept<T>::type;
        std::uint32_t number = 0;
        detail::check(detail::Value<Kept>::in_c(Kept(initial), [&](const downbeat_value_v1 &given) {
            downbeat_setting_v1 setting = {};
            setting.abi_version = DOWNBEAT_ABI_VERSION;
            setting.struct_size = sizeof setting;
            setting.name = name.c_str();
            setting.description = description.c_str();
            setting.initial = &given;
            setting.minimum = range ? range[0] : 0.0;
            setting.maximum = range ? range[1] : 0.0;
            setting.has_range = range ? 1 : 0;
            setting.is_read_only = is_read_only ? 1 : 0;
            return host_->setting(host_, &setting, &number);
        }));
        settings_.emplace_back();
        return Setting<Kept>(this, number);
    }

    void handle(const downbeat_event_v1 &event) {
        switch (event.kind) {
        case DOWNBEAT_MESSAGE:
            return subscriptions_.at(event.port)(event);
        case DOWNBEAT_REQUEST:
            return servers_.at(event.port)(event);
        case DOWNBEAT_REPLY:
            return clients_.at(event.port)(event);
        case DOWNBEAT_TIMER:
            return timers_.at(event.port)();
        case DOWNBEAT_TASK:
            return tasks_.at(event.port)();
        case DOWNBEAT_SETTING:
            if (settings_.at(event.port).on_change) {
                settings_.at(event.port).on_change();
            }
            return;
        case DOWNBEAT_EACH_RUN:
            return each_run_();
        }
    }

    void log_limited(std::int32_t severity, std::int64_t period_ns, const std::string &text, const Place &place) const {
        downbeat_log_limit &limit = log_limits_[place];
        if (!downbeat_log_is_due(host_, &limit, period_ns)) {
            return;
        }
        std::string line = limit.suppressed ? text + " suppressed=" + std::to_string(limit.suppressed) : text;
        limit.suppressed = 0;
        log(severity, line, place);
    }

    void log(std::int32_t severity, const std::string &text, const Place &place) const {
        downbeat_log_at(host_, severity, text.c_str(), place.file(), static_cast<std::uint32_t>(place.line()), place.function());
    }

    template <class T> const std::vector<std::uint8_t> &encoded(const T &message) {
        writer_.start();
        writer_.put(message);
        return writer_.bytes();
    }

    const downbeat_host_v1 *host_ = nullptr;
    cdr::Writer writer_;
    std::vector<Take> subscriptions_, servers_, clients_;
    std::vector<std::function<void()>> timers_, tasks_;
    std::vector<SettingCallbacks> settings_;
    std::function<void()> each_run_;
    mutable std::map<Place, downbeat_log_limit> log_limits_;
    std::vector<std::shared_ptr<void>> actions_;
};

template <class T> void Publisher<T>::operator()(const T &message) const {
    const auto &bytes = module_->encoded(message);
    detail::check(module_->host_->publish(module_->host_, number_, bytes.data(), bytes.size()));
}

template <class S> std::uint64_t Client<S>::operator()(const typename S::Request &request) const {
    const auto &bytes = module_->encoded(request);
    std::uint64_t id = 0;
    detail::check(module_->host_->call(module_->host_, number_, bytes.data(), bytes.size(), &id));
    return id;
}

template <class S> void Request<S>::reply(const typename S::Response &response) const {
    const auto &bytes = module_->encoded(response);
    detail::check(module_->host_->reply(module_->host_, id_, bytes.data(), bytes.size()));
}

template <class S> void Request<S>::refuse(const std::string &reason) const {
    detail::check(module_->host_->reply_error(module_->host_, id_, reason.c_str()));
}

template <class T> T Setting<T>::operator*() const {
    downbeat_value_v1 value = {DOWNBEAT_ABI_VERSION, sizeof value, 0, 0, nullptr, 0};
    detail::check(module_->host_->get(module_->host_, number_, &value));
    return detail::Value<T>::from_c(value);
}

inline void Task::after(std::chrono::nanoseconds delay) const {
    detail::check(module_->host_->schedule_after(module_->host_, number_, delay.count()));
}

inline void Task::cancel() const { detail::check(module_->host_->cancel(module_->host_, number_)); }

namespace detail {

// An action that a module serves: three services and two topics (design.ros2.org/articles/actions.html).
template <class A> struct ActionState {
    // How long the result of a goal is kept for those who ask for it, as in rclcpp's default.
    static constexpr std::chrono::minutes kept{15};

    template <class F> typename A::SendGoal::Response take(const typename A::SendGoal::Request &request, F &callback) {
        forget_old();
        typename A::SendGoal::Response response;
        set_time(response.stamp, module->now());
        if (find(request.goal_id.uuid)) {
            return response;
        }
        auto goal = std::make_shared<GoalState<A>>();
        goal->id = request.goal_id.uuid;
        goal->stamp = module->now();
        goal->request = request.goal;
        goal->status = GoalStatus::executing;
        goals.push_back(goal);
        try {
            callback(Goal<A>(goal, this));
        } catch (const Error &error) {
            module->info(std::string("a goal was refused: ") + error.what());
            goals.erase(std::remove(goals.begin(), goals.end(), goal), goals.end());
            return response;
        }
        publish_status();
        response.accepted = true;
        return response;
    }

    void ask(const typename A::GetResult::Request &request, const Request<typename A::GetResult> &open) {
        GoalState<A> *goal = find(request.goal_id.uuid);
        if (!goal) {
            open.reply({});
        } else if (goal->has_ended()) {
            answer(*goal, open);
        } else {
            goal->waiting.push_back(open);
        }
    }

    typename A::CancelGoal::Response cancel(const typename A::CancelGoal::Request &request) {
        typename A::CancelGoal::Response response;
        const GoalId &wanted = request.goal_info.goal_id.uuid;
        const auto before = time_of(request.goal_info.stamp);
        // A zero id and a zero time cancel all goals (action_msgs/srv/CancelGoal).
        const bool is_any = wanted == GoalId{};
        for (auto &goal : goals) {
            const bool is_meant = (!is_any && goal->id == wanted) || (is_any && before.count() == 0) ||
                                  (before.count() != 0 && goal->stamp <= before);
            if (!goal->has_ended() && is_meant) {
                goal->status = GoalStatus::canceling;
                response.goals_canceling.push_back(info(*goal, response.goals_canceling));
            }
        }
        publish_status();
        const GoalState<A> *known = find(wanted);
        if (response.goals_canceling.empty() && !is_any) {
            response.return_code = known && known->has_ended() ? 3 : 2;
        }
        return response;
    }

    void publish_feedback(const GoalState<A> &goal, const typename A::Feedback &value) {
        typename A::FeedbackMessage message;
        message.goal_id.uuid = goal.id;
        message.feedback = value;
        feedback(message);
    }

    void end(GoalState<A> &goal, GoalStatus how, const typename A::Result &result) {
        if (goal.has_ended()) {
            throw Error("the goal has ended before");
        }
        goal.status = how;
        goal.result = result;
        goal.ended = module->now();
        for (const auto &open : goal.waiting) {
            answer(goal, open);
        }
        goal.waiting.clear();
        publish_status();
    }

    Module *module = nullptr;
    Publisher<typename A::FeedbackMessage> feedback;
    Publisher<typename A::GoalStatusArray> status;
    std::vector<std::shared_ptr<GoalState<A>>> goals;

  private:
    GoalState<A> *find(const GoalId &id) {
        for (auto &goal : goals) {
            if (goal->id == id) {
                return goal.get();
            }
        }
        return nullptr;
    }

    void answer(const GoalState<A> &goal, const Request<typename A::GetResult> &open) {
        typename A::GetResult::Response response;
        response.status = static_cast<std::int8_t>(goal.status);
        response.result = goal.result;
        open.reply(response);
    }

    template <class T> T info(const GoalState<A> &goal, const std::vector<T> &) {
        T info;
        info.goal_id.uuid = goal.id;
        set_time(info.stamp, goal.stamp);
        return info;
    }

    void publish_status() {
        typename A::GoalStatusArray message;
        for (const auto &goal : goals) {
            auto &entry = message.status_list.emplace_back();
            entry.goal_info.goal_id.uuid = goal->id;
            set_time(entry.goal_info.stamp, goal->stamp);
            entry.status = static_cast<std::int8_t>(goal->status);
        }
        status(message);
    }

    void forget_old() {
        const auto now = module->now();
        const auto is_old = [now](const auto &goal) { return goal->has_ended() && now - goal->ended > kept; };
        goals.erase(std::remove_if(goals.begin(), goals.end(), is_old), goals.end());
    }
};

// An action that a module uses.
template <class A> struct ActionClientState {
    struct Sent {
        std::function<void(const GoalEnd<A> &)> then;
        std::function<void(const typename A::Feedback &)> feedback;
    };

    GoalId send(const typename A::Goal &goal, std::function<void(const GoalEnd<A> &)> then,
                std::function<void(const typename A::Feedback &)> feedback) {
        typename A::SendGoal::Request request;
        request.goal_id.uuid = new_id();
        request.goal = goal;
        sent[request.goal_id.uuid] = Sent{std::move(then), std::move(feedback)};
        calls[send_goal(request)] = request.goal_id.uuid;
        return request.goal_id.uuid;
    }

    void cancel(const GoalId &goal) {
        typename A::CancelGoal::Request request;
        request.goal_info.goal_id.uuid = goal;
        cancel_goal(request);
    }

    void accepted(const Reply<typename A::SendGoal::Response> &reply) {
        const GoalId id = take_call(calls, reply.call);
        if (!reply || !reply.response->accepted) {
            return finish({id, GoalStatus::unknown, std::nullopt, reply ? "the goal was refused" : reply.error});
        }
        typename A::GetResult::Request request;
        request.goal_id.uuid = id;
        results[get_result(request)] = id;
    }

    void ended(const Reply<typename A::GetResult::Response> &reply) {
        const GoalId id = take_call(results, reply.call);
        if (!reply) {
            return finish({id, GoalStatus::unknown, std::nullopt, reply.error});
        }
        finish({id, static_cast<GoalStatus>(reply.response->status), reply.response->result, {}});
    }

    void take(const typename A::FeedbackMessage &message) {
        const auto found = sent.find(message.goal_id.uuid);
        if (found != sent.end() && found->second.feedback) {
            // A copy: the callback may end the goal.
            const auto feedback = found->second.feedback;
            feedback(message.feedback);
        }
    }

    Module *module = nullptr;
    Client<typename A::SendGoal> send_goal;
    Client<typename A::GetResult> get_result;
    Client<typename A::CancelGoal> cancel_goal;

  private:
    static GoalId take_call(std::map<std::uint64_t, GoalId> &from, std::uint64_t call) {
        const GoalId id = from[call];
        from.erase(call);
        return id;
    }

    void finish(const GoalEnd<A> &end) {
        const auto found = sent.find(end.id);
        if (found == sent.end()) {
            return;
        }
        const auto then = std::move(found->second.then);
        sent.erase(found);
        if (then) {
            then(end);
        }
    }

    // Different for each goal of each module at each time, and the same in a replay.
    GoalId new_id() {
        const std::string seed =
            module->name() + '/' + std::to_string(module->now().count()) + '/' + std::to_string(number++) + '/';
        GoalId id;
        for (std::size_t half = 0; half < 2; half++) {
            std::uint64_t hash = 14695981039346656037u; // FNV-1a
            for (const char letter : seed + std::to_string(half)) {
                hash = (hash ^ static_cast<unsigned char>(letter)) * 1099511628211u;
            }
            std::memcpy(id.data() + 8 * half, &hash, sizeof hash);
        }
        return id;
    }

    std::map<GoalId, Sent> sent;
    std::map<std::uint64_t, GoalId> calls, results;
    std::uint64_t number = 0;
};


// Calls of the program, with exceptions as reasons.
template <class F> std::int32_t guarded(const downbeat_host_v1 *host, F call) {
    try {
        call();
        return 0;
    } catch (const Refused &) {
        return -1;
    } catch (const std::exception &error) {
        return host->fail(host, error.what());
    } catch (...) {
        return host->fail(host, "an exception that is no std::exception");
    }
}

template <class Class> struct Table {
    static Module &module(void *self, const downbeat_host_v1 *host) {
        auto &module = *static_cast<Module *>(self);
        module.host_ = host;
        return module;
    }
    static void *create(const downbeat_host_v1 *host) {
        Module *created = nullptr;
        guarded(host, [&] { created = std::make_unique<Class>().release(); });
        return created;
    }
    static std::int32_t setup(void *self, const downbeat_host_v1 *host) {
        return guarded(host, [&] { module(self, host).setup(); });
    }
    static std::int32_t handle(void *self, const downbeat_host_v1 *host, const downbeat_event_v1 *event) {
        return guarded(host, [&] { module(self, host).handle(*event); });
    }
    static void destroy(void *self) { delete static_cast<Module *>(self); }
    static std::int32_t transition(void *self, const downbeat_host_v1 *host, std::uint32_t transition) {
        return guarded(host, [&] {
            Module &of = module(self, host);
            switch (transition) {
            case DOWNBEAT_CONFIGURE:
                return of.configure();
            case DOWNBEAT_CLEANUP:
                return of.cleanup();
            case DOWNBEAT_ACTIVATE:
                return of.activate();
            case DOWNBEAT_DEACTIVATE:
                return of.deactivate();
            case DOWNBEAT_SHUTDOWN:
                return of.shutdown();
            }
        });
    }
    static std::int32_t accept(void *self, const downbeat_host_v1 *host, std::uint32_t setting, const downbeat_value_v1 *value) {
        return guarded(host, [&] {
            const auto &check = module(self, host).settings_.at(setting).accept;
            if (check) {
                check(*value);
            }
        });
    }
    static std::int32_t save(void *self, const downbeat_host_v1 *host) {
        return guarded(host, [&] {
            const auto state = module(self, host).save();
            check(host->saved(host, state.data(), state.size()));
        });
    }
    static std::int32_t restore(void *self, const downbeat_host_v1 *host, const std::uint8_t *state, std::size_t size) {
        return guarded(host, [&] { module(self, host).restore(std::vector<std::uint8_t>(state, state + size)); });
    }
    static std::int32_t variables(void *self, const downbeat_host_v1 *host) {
        return guarded(host, [&] {
            Variables reported(host);
            module(self, host).variables(reported);
        });
    }
};

} // namespace detail
} // namespace downbeat

// Exports a class as the module of the library. It needs a default constructor.
#define DOWNBEAT_MODULE(Class)                                                                                                 \
    extern "C" DOWNBEAT_EXPORT const downbeat_module_v1 *downbeat_module(void) {                                               \
        using Table = ::downbeat::detail::Table<Class>;                                                                        \
        static const downbeat_module_v1 table = {                                                                              \
            DOWNBEAT_ABI_VERSION, sizeof(downbeat_module_v1), #Class,        Table::create, Table::setup,  Table::handle,      \
            Table::destroy,       Table::transition,          Table::accept, Table::save,   Table::restore,                    \
            Table::variables};                                                                                                 \
        return &table;                                                                                                         \
    }

#endif
