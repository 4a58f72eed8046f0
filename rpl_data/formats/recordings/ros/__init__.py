"""Reader of ROS recordings: ROS 1 bags (.bag), ROS 2 bags (.db3, .mcap, and their folders)."""
