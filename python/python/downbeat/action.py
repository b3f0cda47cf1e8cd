"""Actions: goals that take time, with feedback and a result, as ROS 2 has them (design.ros2.org/articles/actions.html)."""

from collections.abc import Callable
from typing import Any

from downbeat.module import Module, Refused

ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = range(1, 7)
_ENDED = (SUCCEEDED, CANCELED, ABORTED)

#: How long the result of a goal is kept for those who ask for it, in seconds; as in rclcpp's default.
RESULT_TIMEOUT = 900.0


class Goal:
    """A goal of an action server. The callback that takes it may keep it and go on in later callbacks.

    It ends with one of :meth:`succeed`, :meth:`abort` and :meth:`canceled`. The callback refuses a goal by raising
    :class:`downbeat.Refused`.
    """

    def __init__(self, server: "ActionServer", goal_id: bytes, request: Any, stamp: Any) -> None:
        self._server = server
        self._id = goal_id
        self._stamp = stamp
        self._waiting: list[Any] = []
        self._result: dict[str, Any] = {}
        self._ended_at = 0
        #: What is asked for.
        self.request = request
        self.status = EXECUTING

    @property
    def is_canceling(self) -> bool:
        """True once a client asks to cancel the goal."""
        return self.status == CANCELING

    def feedback(self, **fields: Any) -> None:
        """Publishes feedback."""
        self._server._feedback(goal_id={"uuid": list(self._id)}, feedback=fields)

    def succeed(self, **result: Any) -> None:
        """Ends the goal with a result."""
        self._end(SUCCEEDED, result)

    def abort(self, **result: Any) -> None:
        """Ends the goal: it cannot be reached."""
        self._end(ABORTED, result)

    def canceled(self, **result: Any) -> None:
        """Ends the goal because a client asked to cancel it."""
        self._end(CANCELED, result)

    def _end(self, status: int, result: dict[str, Any]) -> None:
        if self.status in _ENDED:
            raise RuntimeError("the goal has ended before")
        self.status, self._result, self._ended_at = status, result, self._server._module.now()
        for waiting in self._waiting:
            self._answer(waiting)
        self._waiting.clear()
        self._server._publish_status()

    def _answer(self, open: Any) -> None:
        open.reply(status=self.status, result=self._result)


class ActionServer:
    """Serves an action, see :meth:`downbeat.Module.act`."""

    def __init__(self, module: Module, name: str, type: str, callback: Callable[[Goal], None]) -> None:
        self._module = module
        self._callback = callback
        self._goals: dict[bytes, Goal] = {}
        module.serve(f"{name}/_action/send_goal", f"{type}_SendGoal", self._take_goal)
        module.serve_later(f"{name}/_action/get_result", f"{type}_GetResult", self._take_result_request)
        module.serve(f"{name}/_action/cancel_goal", "action_msgs/srv/CancelGoal", self._take_cancel)
        self._feedback = module.publish(f"{name}/_action/feedback", f"{type}_FeedbackMessage")
        self._status = module.publish(f"{name}/_action/status", "action_msgs/msg/GoalStatusArray")

    def _take_goal(self, request: Any) -> dict[str, Any]:
        self._forget_old()
        goal_id = bytes(request.goal_id.uuid)
        stamp = self._module.now().to_msg()
        if goal_id in self._goals:
            return {"accepted": False, "stamp": stamp}
        goal = self._goals[goal_id] = Goal(self, goal_id, request.goal, stamp)
        try:
            self._callback(goal)
        except Refused as refused:
            self._module.log.info(f"a goal was refused: {refused}")
            del self._goals[goal_id]
            return {"accepted": False, "stamp": stamp}
        self._publish_status()
        return {"accepted": True, "stamp": stamp}

    def _take_result_request(self, request: Any, open: Any) -> None:
        goal = self._goals.get(bytes(request.goal_id.uuid))
        if goal is None:
            open.reply(status=0)
        elif goal.status in _ENDED:
            goal._answer(open)
        else:
            goal._waiting.append(open)

    def _take_cancel(self, request: Any) -> dict[str, Any]:
        wanted = bytes(request.goal_info.goal_id.uuid)
        stamp = request.goal_info.stamp
        before = stamp.sec * 1_000_000_000 + stamp.nanosec
        # A zero id and a zero time cancel all goals (action_msgs/srv/CancelGoal).
        of_all = not any(wanted)
        chosen = [
            goal
            for goal_id, goal in self._goals.items()
            if goal.status not in _ENDED
            and (goal_id == wanted or (of_all and before == 0) or (before and _nanoseconds(goal._stamp) <= before))
        ]
        for goal in chosen:
            goal.status = CANCELING
        self._publish_status()
        ended = wanted in self._goals and self._goals[wanted].status in _ENDED
        code = 0 if chosen or (of_all and not ended) else (3 if ended else 2)
        return {"return_code": code, "goals_canceling": [self._info(goal) for goal in chosen]}

    def _publish_status(self) -> None:
        states = [{"goal_info": self._info(goal), "status": goal.status} for goal in self._goals.values()]
        self._status(status_list=states)

    def _info(self, goal: Goal) -> dict[str, Any]:
        return {"goal_id": {"uuid": list(goal._id)}, "stamp": goal._stamp}

    def _forget_old(self) -> None:
        oldest = self._module.now() - RESULT_TIMEOUT * 1e9
        old = [known for known, goal in self._goals.items() if goal.status in _ENDED and goal._ended_at < oldest]
        for known in old:
            del self._goals[known]


class ActionClient:
    """Sends goals to an action, see :meth:`downbeat.Module.action_client`."""

    def __init__(self, module: Module, name: str, type: str, timeout: float | str) -> None:
        self._module = module
        self._send = module.client(f"{name}/_action/send_goal", f"{type}_SendGoal", timeout)
        self._result = module.client(f"{name}/_action/get_result", f"{type}_GetResult", RESULT_TIMEOUT)
        self._cancel = module.client(f"{name}/_action/cancel_goal", "action_msgs/srv/CancelGoal", timeout)
        self._on_feedback: dict[bytes, Callable[[Any], None]] = {}
        module.subscribe(f"{name}/_action/feedback", f"{type}_FeedbackMessage", self._take_feedback)

    def send(
        self,
        goal: Any = None,
        *,
        then: Callable[[int, Any], None],
        feedback: Callable[[Any], None] | None = None,
        **fields: Any,
    ) -> bytes:
        """Sends a goal, as a message or by its fields. ``then`` takes the status with which it ends (4 succeeded, 5 canceled,
        6 aborted, 0 refused) and the result, or the reason as a text if there is none. Returns the id of the goal, for
        :meth:`cancel`."""
        goal_id = self._module.random.randbytes(16)
        if feedback is not None:
            self._on_feedback[goal_id] = feedback

        def ended(response: Any, problem: str | None) -> None:
            self._on_feedback.pop(goal_id, None)
            if problem is None:
                then(response.status, response.result)
            else:
                then(0, problem)

        def accepted(response: Any, problem: str | None) -> None:
            if problem is not None:
                ended(None, problem)
            elif not response.accepted:
                ended(None, "the goal was refused")
            else:
                self._result(goal_id={"uuid": list(goal_id)}, then=ended)

        self._send(goal_id={"uuid": list(goal_id)}, goal=fields if goal is None else goal, then=accepted)
        return goal_id

    def cancel(self, goal_id: bytes, then: Callable[[Any, str | None], None] = lambda response, problem: None) -> None:
        """Asks to cancel a goal. ``then`` takes the ``action_msgs/srv/CancelGoal`` response."""
        self._cancel(goal_info={"goal_id": {"uuid": list(goal_id)}}, then=then)

    def _take_feedback(self, message: Any) -> None:
        take = self._on_feedback.get(bytes(message.goal_id.uuid))
        if take is not None:
            take(message.feedback)


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
