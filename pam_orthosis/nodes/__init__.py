# SPDX-License-Identifier: Apache-2.0
"""rclpy nodes: messages to calls and back, no mathematics."""
