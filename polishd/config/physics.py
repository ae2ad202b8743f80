"""What files about a process share, and what they share about a part: sections made into the nouns of the physics."""

from __future__ import annotations

from dataclasses import fields

from polishd.config.document import TomlDocument
from polishd.config.process import ComplianceSection, HybridSection, KinematicsSection, ProcessSection
from polishd.config.robots import robot_of
from polishd.config.sections import PartSection
from polishd.config.tables import read_polygon
from polishd.model.errors import ConfigError
from polishd.model.outline import Outline
from polishd.model.process import ComplianceOptions, Optic, Placement, ToolProcess
from polishd.model.robot import RobotModel
from polishd.process.frames import rotation_from_rpy_deg


class ProcessDocument(TomlDocument):
    """A file about a process."""

    process: ProcessSection = ProcessSection()

    def tool_process(self) -> ToolProcess:
        """Tool, contact and Preston constant."""
        shared = {item.name for item in fields(ToolProcess)} & set(ProcessSection.model_fields)
        values = {name: getattr(self.process, name) for name in shared}
        return ToolProcess(preston_cm2_per_n=self.process.preston, **values)


class PartDocument(ProcessDocument):
    """A file about a process on a part, by a robot."""

    part: PartSection
    kinematics: KinematicsSection = HybridSection()
    compliance: ComplianceSection = ComplianceSection()

    def robot_model(self) -> RobotModel:
        """The robot's geometry and stiffness; ConfigError where its table cannot be read."""
        return robot_of(self.kinematics, self.resolve)

    def compliance_options(self) -> ComplianceOptions:
        """How the robot's compliance is read."""
        return ComplianceOptions(**dict(self.compliance))

    def outline(self) -> Outline:
        """The part's outline about its centre; ConfigError where its file says none."""
        if self.part.polygon_file is None:
            return self.part.outline
        try:
            found = read_polygon(self.resolve(self.part.polygon_file))
        except ConfigError as error:
            raise self.error("part.polygon_file", str(error)) from error
        for wrong, problem in self.part.misfits(found):
            raise self.error(f"part.{wrong}", problem)
        return found

    def optic(self) -> Optic:
        """The nominal surface."""
        return Optic(self.part.curvature_radius_mm, self.part.conic, self.part.even, self.part.off_axis_mm)

    def placement(self) -> Placement:
        """Where the part lies in the robot's base frame."""
        return Placement(self.part.origin_mm, rotation_from_rpy_deg(*self.part.rotation_rpy_deg))
