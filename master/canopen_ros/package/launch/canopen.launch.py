"""Start the node, and with `control:=true`, once all joint states are there, the controllers of ros2_control on top of it.

    ros2 launch DIR/launch/canopen.launch.py simulate:=true
    ros2 launch DIR/launch/canopen.launch.py machine:=cell.toml python:=ENVIRONMENT/bin/python control:=true

DIR: the package that `canopen ros init` wrote, such as ros/ros_canopen. python: of the environment that has canopen-proto and
sees rclpy (made with --system-site-packages).
"""

import xml.etree.ElementTree
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import DeclareLaunchArgument, ExecuteProcess, LogInfo, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events.process import ProcessExited
from launch_ros.actions import LifecycleNode, Node

PACKAGE = Path(__file__).resolve().parents[1]

ARGUMENTS = {
    "machine": ("", "the machine file; without one, the chains of `config`"),
    "config": (str(PACKAGE / "config" / "six_joints.ros2.yaml"), "parameters of the node, if there is no machine file"),
    "simulate": ("false", "true: simulated drives in place of the buses"),
    "python": ("python3", "the Python that has canopen-proto and sees rclpy"),
    "control": ("false", "true: also ros2_control's controller_manager and the controller of config/controllers.yaml"),
    "urdf": (str(PACKAGE / "urdf" / "six_joints.urdf"), "the robot, for ros2_control"),
}


def node_and_controllers(context: LaunchContext) -> list[Action]:
    """Return what is to be started."""
    given = {name: context.launch_configurations[name] for name in ARGUMENTS}
    parameters: list[object] = [{"machine": given["machine"]} if given["machine"] else given["config"]]
    parameters.append({"simulate": given["simulate"].lower() == "true"})
    found: list[Action] = [
        LifecycleNode(
            name="ros_canopen",
            namespace="",
            executable=given["python"],
            arguments=["-m", "canopen_ros.ros2"],
            parameters=parameters,
            output="screen",
            sigterm_timeout="30",  # after Ctrl-C the joints brake, and the drives are shut down
        )
    ]
    if given["control"].lower() == "true":
        description = Path(given["urdf"]).read_text(encoding="utf-8")
        controllers = str(PACKAGE / "config" / "controllers.yaml")
        found.append(
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                parameters=[{"robot_description": description}],
            )
        )
        # No joint_state_broadcaster: the node publishes /joint_states, and the hardware reads them there
        control: list[Action] = [
            Node(package="controller_manager", executable="ros2_control_node", parameters=[controllers], output="screen"),
            Node(package="controller_manager", executable="spawner", arguments=["arm_controller", "--param-file", controllers]),
        ]
        joints = [each.get("name", "") for each in xml.etree.ElementTree.fromstring(description).findall("ros2_control/joint")]
        # A controller begins where the joints are when it starts
        waiting = ExecuteProcess(cmd=[given["python"], "-m", "canopen_ros.ros2.await_joints", *joints], output="screen")

        def begin(event: ProcessExited, context: LaunchContext) -> list[Action]:
            failed = LogInfo(msg=f"no controllers: waiting for the joint states ended with exit status {event.returncode}")
            return control if event.returncode == 0 else [failed]

        found += [RegisterEventHandler(OnProcessExit(target_action=waiting, on_exit=begin)), waiting]
    return found


def generate_launch_description() -> LaunchDescription:
    """Called by `ros2 launch`."""
    declared = [DeclareLaunchArgument(name, default_value=value, description=text) for name, (value, text) in ARGUMENTS.items()]
    return LaunchDescription([*declared, OpaqueFunction(function=node_and_controllers)])
