"""A ROS 2 node around a stepped radar: odometry in, points out. Not tested here, where there is no ROS.

python examples/ros2_node.py hills --ros-args -r odom:=/fmu/odometry
"""

import sys

import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from rclpy.node import Node
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from sensor_msgs_py.point_cloud2 import create_cloud_xyz32

from sionna_radar import Radar, load_scenario


class RadarNode(Node):
    """Steps the radar by each odometry message, in the frames of REP 103: east, north, up, and nose, left, up."""

    def __init__(self, scenario):
        super().__init__("sionna_radar")
        self.radar, self.start_s = Radar(load_scenario(scenario)), None
        self.radar.warm_up()
        self.points = self.create_publisher(PointCloud2, "points", 10)
        self.create_subscription(Odometry, "odom", self.take, 10)

    def take(self, message):
        stamp_s = message.header.stamp.sec + message.header.stamp.nanosec / 1e9
        self.start_s = stamp_s if self.start_s is None else self.start_s
        pose, twist = message.pose.pose, message.twist.twist
        turned = Rotation.from_quat([pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w])
        R_world_body = turned.as_matrix() @ np.diag([1.0, -1.0, -1.0])
        velocity = turned.apply([twist.linear.x, twist.linear.y, twist.linear.z])
        place_m = [pose.position.x, pose.position.y, pose.position.z]
        frame = self.radar.step(stamp_s - self.start_s, place_m, R_world_body, velocity)
        self.points.publish(create_cloud_xyz32(message.header, frame.points.position_m.astype(np.float32)))


rclpy.init()
rclpy.spin(RadarNode(next((name for name in sys.argv[1:] if not name.startswith("-")), "hills")))
