"""The robot link: the project's protocol to a robot controller, docs/protocols/robot_link.md."""
