# SPDX-License-Identifier: Apache-2.0
"""Fields of the types of the topics' table and of what viewers receive.

They are tested against the standard's: to load all of these takes a fifth of a second.
"""

FIELDS = {
    "builtin_interfaces/msg/Time": "int32 sec, uint32 nanosec",
    "builtin_interfaces/msg/Duration": "int32 sec, uint32 nanosec",
    "std_msgs/msg/Header": "builtin_interfaces/msg/Time stamp, string frame_id",
    "rosgraph_msgs/msg/Clock": "builtin_interfaces/msg/Time clock",
    "sensor_msgs/msg/JointState": "std_msgs/msg/Header header, string[] name, float64[] position,"
    " float64[] velocity, float64[] effort",
    "sensor_msgs/msg/FluidPressure": "std_msgs/msg/Header header, float64 fluid_pressure, float64 variance",
    "sensor_msgs/msg/TimeReference": "std_msgs/msg/Header header, builtin_interfaces/msg/Time time_ref,"
    " string source",
    "geometry_msgs/msg/Vector3": "float64 x, float64 y, float64 z",
    "geometry_msgs/msg/Vector3Stamped": "std_msgs/msg/Header header, geometry_msgs/msg/Vector3 vector",
    "geometry_msgs/msg/Wrench": "geometry_msgs/msg/Vector3 force, geometry_msgs/msg/Vector3 torque",
    "geometry_msgs/msg/WrenchStamped": "std_msgs/msg/Header header, geometry_msgs/msg/Wrench wrench",
    "trajectory_msgs/msg/JointTrajectoryPoint": "float64[] positions, float64[] velocities,"
    " float64[] accelerations, float64[] effort, builtin_interfaces/msg/Duration time_from_start",
    "trajectory_msgs/msg/JointTrajectory": "std_msgs/msg/Header header, string[] joint_names,"
    " trajectory_msgs/msg/JointTrajectoryPoint[] points",
    "diagnostic_msgs/msg/KeyValue": "string key, string value",
    "diagnostic_msgs/msg/DiagnosticStatus": "byte level, string name, string message, string hardware_id,"
    " diagnostic_msgs/msg/KeyValue[] values",
    "diagnostic_msgs/msg/DiagnosticArray": "std_msgs/msg/Header header,"
    " diagnostic_msgs/msg/DiagnosticStatus[] status",
    "geometry_msgs/msg/Point": "float64 x, float64 y, float64 z",
    "geometry_msgs/msg/Quaternion": "float64 x, float64 y, float64 z, float64 w",
    "geometry_msgs/msg/Pose": "geometry_msgs/msg/Point position, geometry_msgs/msg/Quaternion orientation",
    "geometry_msgs/msg/Transform": "geometry_msgs/msg/Vector3 translation,"
    " geometry_msgs/msg/Quaternion rotation",
    "geometry_msgs/msg/TransformStamped": "std_msgs/msg/Header header, string child_frame_id,"
    " geometry_msgs/msg/Transform transform",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/msg/TransformStamped[] transforms",
    "std_msgs/msg/ColorRGBA": "float32 r, float32 g, float32 b, float32 a",
    "sensor_msgs/msg/CompressedImage": "std_msgs/msg/Header header, string format, uint8[] data",
    "visualization_msgs/msg/UVCoordinate": "float32 u, float32 v",
    "visualization_msgs/msg/MeshFile": "string filename, uint8[] data",
    "visualization_msgs/msg/Marker": "std_msgs/msg/Header header, string ns, int32 id, int32 type,"
    " int32 action, geometry_msgs/msg/Pose pose, geometry_msgs/msg/Vector3 scale,"
    " std_msgs/msg/ColorRGBA color, builtin_interfaces/msg/Duration lifetime, bool frame_locked,"
    " geometry_msgs/msg/Point[] points, std_msgs/msg/ColorRGBA[] colors, string texture_resource,"
    " sensor_msgs/msg/CompressedImage texture, visualization_msgs/msg/UVCoordinate[] uv_coordinates,"
    " string text, string mesh_resource, visualization_msgs/msg/MeshFile mesh_file,"
    " bool mesh_use_embedded_materials",
    "visualization_msgs/msg/MarkerArray": "visualization_msgs/msg/Marker[] markers",
}
