"""The ROS 2 nodes. This is the only folder that imports rclpy."""
