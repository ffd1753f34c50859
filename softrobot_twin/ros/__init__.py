"""The nodes. The only room that imports rclpy."""
