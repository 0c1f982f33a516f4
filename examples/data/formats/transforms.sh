#!/bin/sh
# driftplan file version 1, frame map, metres
ros2 run tf2_ros static_transform_publisher --x 4.1 --y 2.8 --yaw 0.0 --frame-id map --child-frame-id tag_0 &
ros2 run tf2_ros static_transform_publisher --x 8.0 --y 3.0 --yaw 0.0 --frame-id map --child-frame-id tag_1 &
wait
