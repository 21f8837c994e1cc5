"""Logs of messages by topic: MCAP files and rosbag2 databases."""
