"""Actions in a node of rclpy: the calls of `ros2 action`, and a server whose goals end on command."""

import threading

from rclpy.action import (
    ActionClient,
    ActionServer,
    CancelResponse,
    GoalResponse,
    get_action_client_names_and_types_by_node,
    get_action_names_and_types,
    get_action_server_names_and_types_by_node,
)
from rclpy.action.server import RCLError
from rclpy.node import NodeNameNonExistentError
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID

TIMEOUT = 20.0  # s


def wait(future):
    """The result of a future that another thread completes, nothing if that takes too long."""
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    return future.result() if done.wait(TIMEOUT) else None


def hexadecimal(goal_id):
    return bytes(goal_id.uuid).hex()


class Actions:
    """Needs `node`, `executor`, `message_class` and `fill` of who it is mixed into."""

    def __init__(self):
        self.action_clients = {}
        self.action_servers = {}
        self.sent = {}
        self.feedback = {}
        self.results = {}
        self.working = {}

    def ask(self, request, *arguments, **options):
        """The future of a request. It is made in the thread of the executor: from another one, the answer can come before the client
        of rclpy notes that it waits for it, and is then ignored."""
        return wait(self.executor.create_task(lambda: request(*arguments, **options)))

    # As `ros2 action list -t` and `ros2 action info`.

    def actions(self):
        return dict(get_action_names_and_types(self.node))

    def actions_of(self, node, namespace, servers):
        get = get_action_server_names_and_types_by_node if servers else get_action_client_names_and_types_by_node
        try:
            return dict(get(self.node, node, namespace))
        except (NodeNameNonExistentError, RCLError):
            return {}  # the node is not known yet

    # As `ros2 action send_goal --feedback`.

    def action_client(self, action, type):
        self.action_clients[action] = ActionClient(self.node, self.message_class(type), action)

    def wait_for_action(self, action):
        return self.action_clients[action].wait_for_server(timeout_sec=TIMEOUT)

    def send_goal(self, action, goal, id=None):
        """Its id, or nothing if it was not accepted. Asks for the result at once."""
        client = self.action_clients[action]
        uuid = None if id is None else UUID(uuid=list(bytes.fromhex(id)))
        message = self.fill(client._action_type.Goal(), goal)
        feedback = []

        def on_feedback(message):
            feedback.append(list(message.feedback.sequence))

        handle = wait(self.ask(client.send_goal_async, message, feedback_callback=on_feedback, goal_uuid=uuid))
        if handle is None or not handle.accepted:
            return None
        goal_id = hexadecimal(handle.goal_id)
        self.sent[goal_id] = handle
        self.feedback[goal_id] = feedback
        self.results[goal_id] = self.ask(handle.get_result_async)
        return goal_id

    def feedback_to(self, goal):
        return self.feedback[goal]

    def result_of(self, goal, anew=False):
        """What came of it; `anew` asks the server once more."""
        response = wait(self.ask(self.sent[goal].get_result_async) if anew else self.results[goal])
        return None if response is None else [response.status, list(response.result.sequence)]

    def status_of(self, goal):
        """What the topic of statuses said last."""
        return self.sent[goal].status

    def cancel_goal(self, goal):
        response = wait(self.ask(self.sent[goal].cancel_goal_async))
        return None if response is None else [response.return_code, [hexadecimal(info.goal_id) for info in response.goals_canceling]]

    # A server of Fibonacci.

    def action_server(self, action, type, result_timeout=10):
        kind = self.message_class(type)

        async def execute(handle):
            future = Future(executor=self.executor)
            self.working[hexadecimal(handle.goal_id)] = (handle, future)
            end, sequence = await future
            getattr(handle, end)()
            return kind.Result(sequence=sequence)

        self.action_servers[action] = ActionServer(
            self.node,
            kind,
            action,
            execute,
            goal_callback=lambda goal: GoalResponse.REJECT if goal.order < 0 else GoalResponse.ACCEPT,
            cancel_callback=lambda handle: CancelResponse.REJECT if handle.request.order == 13 else CancelResponse.ACCEPT,
            result_timeout=result_timeout,
        )

    def working_on(self):
        """The goals it works on: id, order, and whether it is to be canceled."""
        return [[goal, handle.request.order, handle.is_cancel_requested] for goal, (handle, _) in self.working.items()]

    def tell(self, goal, sequence):
        handle, _ = self.working[goal]
        kind = handle._action_server.action_type
        handle.publish_feedback(kind.Feedback(sequence=sequence))

    def end(self, goal, how, sequence):
        """`succeed`, `abort` or `canceled`."""
        _, future = self.working.pop(goal)
        self.executor.create_task(future.set_result, (how, sequence))
