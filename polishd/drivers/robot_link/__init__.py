"""Robot link: polishd's protocol to a robot controller, docs/protocols/robot_link.md."""
