"""A node of rclpy that offers std_srvs/srv/SetBool on /set_torque with service introspection, and calls it twice for each line
that it reads. Its events are latched, so late joiners receive them all. It ends when its standard input closes. Usage: introspected_service.py"""

import sys
import threading

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.service_introspection import ServiceIntrospectionState
from std_srvs.srv import SetBool

rclpy.init()
node = rclpy.create_node("torque")


def on_request(request, response):
    response.success = request.data
    response.message = "torque is " + ("on" if request.data else "off")
    return response


service = node.create_service(SetBool, "set_torque", on_request)
client = node.create_client(SetBool, "set_torque")
latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
for endpoint in (service, client):
    endpoint.configure_introspection(node.get_clock(), latched, ServiceIntrospectionState.CONTENTS)
executor = SingleThreadedExecutor()
executor.add_node(node)
thread = threading.Thread(target=executor.spin)
thread.start()
client.wait_for_service()
print("ready", flush=True)
for line in sys.stdin:
    for data in (True, False):
        done = threading.Event()
        client.call_async(SetBool.Request(data=data)).add_done_callback(lambda _: done.set())
        done.wait(20.0)
    print("called", flush=True)
executor.shutdown()
thread.join()
node.destroy_node()
rclpy.shutdown()
