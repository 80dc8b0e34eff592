"""The double pendulum of DFKI as a case: its recording is in shared/data, its mechanism from the page beside it."""

from pathlib import Path

import yaml

from .arm_case import arm_meta

DFKI = Path(__file__).resolve().parents[3] / "shared" / "data" / "dfki_double_pendulum"

DFKI_ARM = """<mujoco model="double_pendulum"><compiler angle="radian"/>
<default><joint axis="0 -1 0" damping="0.001" armature="0.00226332"/></default><worldbody>
<body name="upper"><joint name="shoulder"/>
  <inertial pos="0 0 -0.2" mass="0.52346" diaginertia="0.0109486 0.0109486 0.0001"/>
  <body name="lower" pos="0 0 -0.2"><joint name="elbow"/>
    <inertial pos="0 0 -0.25569" mass="0.62557" diaginertia="0.00997254 0.00997254 0.0001"/>
</body></body></worldbody></mujoco>"""


def write_dfki(folder: Path, unknown: list[str]) -> Path:
    """Write the case of the real double pendulum, its mechanism from the published model on the data's page.

    Inertias about the joints less m r^2 (page: 0.031887 and 0.050870 kg m^2; r 0.2 and 0.25569 m); armature of rotors
    behind gears, 6.287e-5 kg m^2 x 6^2.
    """
    folder.mkdir()
    (folder / "arm.xml").write_text(DFKI_ARM)
    (folder / "run.csv").write_text((DFKI / "dfki_double_pendulum_sysid.csv").read_text())
    meta = arm_meta(["run.csv"], unknown) | {"resample_hz": 500.0}
    for k, item in enumerate(meta["input"]):
        item["column"] = f"torque{k + 1}_measured_Nm"
    for k, item in enumerate(meta["outputs"]):
        item["column"] = f"angle{k + 1}_rad"
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    return folder
