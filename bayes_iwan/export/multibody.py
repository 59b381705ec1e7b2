"""The mujoco target (a passive force by Python's callback, and the source of a plugin in C) and the drake target (a
LeafSystem in Python with discrete state). Each gives the files beside isolator.c and isolator.py, and what the card
says of them."""

import hashlib

from bayes_iwan.export.c_code import c_source, filled, template
from bayes_iwan.export.card import Card
from bayes_iwan.export.device import Device

MUJOCO, PLUGIN, DRAKE = "isolator_mujoco.py", "isolator_plugin.c", "isolator_drake.py"
NAMES: tuple[str, ...] = (MUJOCO, PLUGIN, DRAKE)
Files = tuple[dict[str, str | bytes], tuple[str, ...]]


def mujoco_files(device: Device, card: Card) -> Files:
    # two devices in one scene are two plugins
    name = f"bayes_iwan.{hashlib.sha256(c_source(device, '').encode()).hexdigest()[:8]}"
    return {MUJOCO: template(MUJOCO), PLUGIN: filled(template(PLUGIN), {"NAME": name})}, (
        "isolator_mujoco.py: a force on a joint or tendon (mujoco 3 or later); isolator_plugin.c: the same as a "
        f"plugin, {name}, for joints, its memory in mjData; the stretch is measured from the model's qpos0",
    )


def drake_files(device: Device, card: Card) -> Files:
    return {DRAKE: template(DRAKE)}, (
        "isolator_drake.py: IsolatorSystem, input motion (m, m/s, m/s2), output force (N); its memory is discrete "
        "state, updated every step_s",
    )
