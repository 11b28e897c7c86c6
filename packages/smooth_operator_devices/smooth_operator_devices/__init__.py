"""Robot hands, trackers and ROS 2 for smooth-operator."""
