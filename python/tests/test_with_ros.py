"""Modules in Python as ROS 2 sees them: real rclpy hears their topics, sets their parameters and calls their services."""

import threading
import time

import downbeat
import pytest

rclpy = pytest.importorskip("rclpy", reason="real ROS 2 is not installed here: see `cargo xtask python`")

ROBOT = """
    [robot]
    name = "level"

    [[module]]
    kind = "python"
    name = "level_head"
    module = "level_head.py:LevelHead"

    [expose]
    out = ["joint_commands"]
    in = ["imu/data_raw"]
    parameters = ["level_head.*"]
    services = ["level"]
"""

LEVEL_HEAD = """
    import downbeat as db

    class LevelHead(db.Module):
        gain = db.setting(0.5, unit="s", range=(0, 1))

        def setup(self):
            self.tilt = 0.0
            self.goal = None
            self.out = self.publish("joint_commands", "sensor_msgs/msg/JointState")

        @db.subscribe("imu/data_raw", "sensor_msgs/msg/Imu")
        def imu(self, m):
            self.tilt += m.angular_velocity.y * self.gain

        @db.every("20ms")
        def tick(self):
            self.out(name=["head_tilt"], position=[self.tilt])

        @db.serve("level", "std_srvs/srv/Trigger")
        def level(self, request):
            was, self.tilt = self.tilt, 0.0
            return {"success": True, "message": f"was {was}"}
"""


class Peer:
    """A node of rclpy that spins on a thread of its own."""

    def __init__(self, domain: int) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("peer", context=self.context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self._spin)
        self.thread.start()

    def _spin(self) -> None:
        try:
            self.executor.spin()
        except rclpy.executors.ExternalShutdownException:
            pass

    def wait(self, condition, what: str):
        end = time.monotonic() + 60.0
        while not (result := condition()):
            assert time.monotonic() < end, f"waited in vain for {what}"
            time.sleep(0.02)
        return result

    def call(self, client, request):
        assert client.wait_for_service(60.0), client.srv_name
        future = client.call_async(request)
        self.wait(future.done, client.srv_name)
        return future.result()

    def stop(self) -> None:
        self.executor.shutdown()
        self.context.shutdown()
        self.thread.join()


@pytest.fixture
def robot(write, domain):
    write("level_head.py", LEVEL_HEAD)
    with downbeat.start(write("robot.toml", ROBOT)) as running:
        peer = Peer(domain)
        yield running, peer
        peer.stop()


def test_rclpy_hears_sets_and_calls(robot):
    from rcl_interfaces.srv import GetParameters, SetParameters
    from rclpy.parameter import Parameter
    from sensor_msgs.msg import Imu, JointState
    from std_srvs.srv import Trigger

    _, peer = robot
    tilts = []
    peer.node.create_subscription(JointState, "joint_commands", lambda m: tilts.append(m.position[0]), 10)
    peer.wait(lambda: tilts, "joint_commands")

    imu = peer.node.create_publisher(Imu, "imu/data_raw", 10)
    message = Imu()
    message.angular_velocity.y = 2.0

    def tilted() -> bool:
        imu.publish(message)
        return tilts[-1] >= 1.0

    peer.wait(tilted, "a tilt")

    setter = peer.node.create_client(SetParameters, "/level/set_parameters")
    values = [Parameter("level_head.gain", value=value).to_parameter_msg() for value in (0.25, 7.0)]
    results = peer.call(setter, SetParameters.Request(parameters=values)).results
    assert [result.successful for result in results] == [True, False]
    assert "7 is out of range" in results[1].reason
    getter = peer.node.create_client(GetParameters, "/level/get_parameters")
    gain = peer.call(getter, GetParameters.Request(names=["level_head.gain"])).values[0]
    assert gain.double_value == 0.25

    response = peer.call(peer.node.create_client(Trigger, "level"), Trigger.Request())
    assert response.success and float(response.message.removeprefix("was ")) >= 1.0


def test_rclpys_messages_are_published_as_they_are(write, domain):
    write(
        "module.py",
        """
        import downbeat as db
        from geometry_msgs.msg import Twist

        class M(db.Module):
            def setup(self):
                self.out = self.publish("cmd_vel", "geometry_msgs/msg/Twist")

            @db.every("20ms")
            def tick(self):
                m = Twist()
                m.linear.x = 0.25
                self.out(m)
        """,
    )
    robot = write(
        "robot.toml",
        """
        [robot]
        name = "twist"

        [[module]]
        kind = "python"
        name = "module"
        module = "module.py:M"

        [expose]
        out = ["cmd_vel"]
        """,
    )
    from geometry_msgs.msg import Twist

    with downbeat.start(robot):
        peer = Peer(domain)
        heard = []
        peer.node.create_subscription(Twist, "cmd_vel", heard.append, 10)
        peer.wait(lambda: heard, "cmd_vel")
        peer.stop()
    assert heard[0].linear.x == 0.25


UNRELIABLE = """
    import downbeat as db

    class Unreliable(db.Module):
        def setup(self):
            self.held = []
            self.serve_later("hold", "std_srvs/srv/Trigger", self.hold)
            self.serve_later("leave", "std_srvs/srv/Trigger", self.leave)

        @db.serve("refuse", "std_srvs/srv/Trigger")
        def refuse(self, request):
            raise db.Refused("the lamp is broken")

        @db.serve("fail", "std_srvs/srv/Trigger")
        def fail(self, request):
            raise ValueError("the vial is empty")

        def hold(self, request, open):
            self.held.append(open)

        def leave(self, request, open):
            self.remove(self.name)

        @db.action("count", "test_msgs/action/Fibonacci")
        def count(self, goal):
            if goal.request.order > 100:
                raise ValueError("it cannot count that far")
            if goal.request.order < 0:
                raise db.Refused("it counts up")
            if goal.request.order == 0:
                goal.succeed()
            self.held.append(goal)
"""

UNRELIABLE_ROBOT = """
    [robot]
    name = "unreliable"

    [[module]]
    kind = "python"
    name = "server"
    module = "unreliable.py:Unreliable"
    restart = { times = 100, backoff = "10ms" }

    [expose]
    services = ["refuse", "fail", "leave", { service = "hold", timeout = "300ms" }]
    actions = ["count"]
"""


def test_rclpy_has_an_answer_whatever_a_handler_does(write, domain):
    write("unreliable.py", UNRELIABLE)
    from rclpy.action import ActionClient
    from std_srvs.srv import Trigger
    from test_msgs.action import Fibonacci

    with downbeat.start(write("robot.toml", UNRELIABLE_ROBOT)):
        peer = Peer(domain)

        def call(service):
            response = peer.call(peer.node.create_client(Trigger, service), Trigger.Request())
            assert not response.success
            return response.message

        def started_again():
            peer.wait(lambda: call("refuse") == "the lamp is broken", "the module to start again")

        started_again()
        assert call("fail") == 'service "fail": module "server" has failed: ValueError: the vial is empty'
        started_again()
        assert call("hold") == 'service "hold": no answer in 300ms'

        action = ActionClient(peer.node, Fibonacci, "count")
        assert action.wait_for_server(60.0)

        def send(order):
            sent = action.send_goal_async(Fibonacci.Goal(order=order))
            peer.wait(sent.done, "the answer to the goal")
            return sent.result()

        assert not send(-1).accepted and not send(200).accepted
        started_again()
        goal = send(3)
        assert goal.accepted
        canceled = goal.cancel_goal_async()
        peer.wait(canceled.done, "the answer to the cancel request")
        assert canceled.result().return_code == 0
        result = goal.get_result_async()
        # The goal is lost with its module.
        assert "the vial is empty" in call("fail")
        peer.wait(result.done, "the result")
        assert result.result().status == 6
        started_again()

        def code_of_cancel(goal):
            canceled = goal.cancel_goal_async()
            peer.wait(canceled.done, "the answer to the cancel request")
            assert not canceled.result().goals_canceling
            return canceled.result().return_code

        # Of one that the module does not know any more, and of one that has ended.
        assert code_of_cancel(goal) == 2
        assert code_of_cancel(send(0)) == 3
        last = send(3)
        result = last.get_result_async()
        assert call("leave") == 'service "leave": module "server" does not run and cannot answer'
        peer.wait(result.done, "the result of a goal whose module has left")
        assert result.result().status == 6
        assert code_of_cancel(last) == 1 and not send(3).accepted
        assert call("refuse") == 'service "refuse": no module serves it'
        peer.stop()


OWN = """
    import downbeat as db

    class Counter(db.Module):
        def setup(self):
            self.goal = None

        @db.serve("echo", "test_msgs/srv/BasicTypes")
        def echo(self, request):
            return {"int64_value": -request.int64_value, "string_value": request.string_value + "!"}

        @db.action("count", "test_msgs/action/Fibonacci")
        def count(self, goal):
            self.goal = goal

        @db.every("20ms")
        def work(self):
            if self.goal is not None:
                self.goal.feedback(sequence=[1, 1])
                self.goal.succeed(sequence=list(range(self.goal.request.order)))
                self.goal = None
"""

OWN_ROBOT = """
    [robot]
    name = "counter"

    [[module]]
    kind = "python"
    name = "counter"
    module = "counter.py:Counter"

    [expose]
    services = ["echo"]
    actions = ["count"]
    service_introspection = "contents"
"""


def test_rclpy_calls_services_and_actions_that_the_program_knows_by_definition_only(write, domain):
    write("counter.py", OWN)
    from rclpy.action import ActionClient
    from test_msgs.action import Fibonacci
    from test_msgs.srv import BasicTypes

    with downbeat.start(write("robot.toml", OWN_ROBOT)):
        peer = Peer(domain)
        events = []
        peer.node.create_subscription(BasicTypes.Event, "echo/_service_event", events.append, 10)
        client = peer.node.create_client(BasicTypes, "echo")
        peer.wait(lambda: peer.node.count_publishers("/echo/_service_event"), "events")
        # The type and its hash are announced as rclpy's own.
        own = peer.node.create_publisher(BasicTypes.Event, "own", 10)
        (theirs,) = peer.node.get_publishers_info_by_topic("/echo/_service_event")
        (ours,) = peer.wait(lambda: peer.node.get_publishers_info_by_topic("/own"), "its own publisher")
        assert (theirs.topic_type, theirs.topic_type_hash) == (ours.topic_type, ours.topic_type_hash)
        peer.node.destroy_publisher(own)

        def calls_until_heard() -> bool:
            # Who publishes is known a little before the publisher knows who listens.
            response = peer.call(client, BasicTypes.Request(int64_value=2**40, string_value="grün"))
            assert (response.int64_value, response.string_value) == (-(2**40), "grün!")
            return any(event.request for event in events) and any(event.response for event in events)

        peer.wait(calls_until_heard, "a request and a response")
        asked = next(event.request[0] for event in events if event.request)
        assert (asked.int64_value, asked.string_value) == (2**40, "grün")

        action = ActionClient(peer.node, Fibonacci, "count")
        assert action.wait_for_server(60.0)
        heard = []

        def goals_until_heard() -> bool:
            sent = action.send_goal_async(Fibonacci.Goal(order=4), feedback_callback=heard.append)
            peer.wait(sent.done, "the goal")
            assert sent.result().accepted
            result = sent.result().get_result_async()
            peer.wait(result.done, "the result")
            assert list(result.result().result.sequence) == [0, 1, 2, 3]
            return bool(heard)

        peer.wait(goals_until_heard, "feedback")
        assert list(heard[0].feedback.sequence) == [1, 1]
        peer.stop()
