# SPDX-License-Identifier: Apache-2.0
"""rosbag2/MCAP files, read and written without ROS."""
