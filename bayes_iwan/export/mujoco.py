"""The mujoco target: a passive force by Python's callback, and the source of a plugin in C."""

import hashlib

from bayes_iwan.export.c_code import c_source, filled, template
from bayes_iwan.export.card import Card
from bayes_iwan.export.device import Device

NAMES: tuple[str, ...] = ("isolator_mujoco.py", "isolator_plugin.c")


def files(device: Device, card: Card) -> tuple[dict[str, str | bytes], tuple[str, ...]]:
    """Files beside isolator.c and isolator.py, and what the card says of them."""
    # two devices in one scene are two plugins
    name = f"bayes_iwan.{hashlib.sha256(c_source(device, '').encode()).hexdigest()[:8]}"
    return {NAMES[0]: template(NAMES[0]), NAMES[1]: filled(template(NAMES[1]), {"NAME": name})}, (
        "isolator_mujoco.py: a force on a joint or tendon (mujoco 3 or later); isolator_plugin.c: the same as a "
        f"plugin, {name}, for joints, its memory in mjData; the stretch is measured from the model's qpos0",
    )
