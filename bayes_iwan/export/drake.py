"""The drake target: a LeafSystem in Python with discrete state."""

from bayes_iwan.export.c_code import template
from bayes_iwan.export.card import Card
from bayes_iwan.export.device import Device

NAMES: tuple[str, ...] = ("isolator_drake.py",)


def files(device: Device, card: Card) -> tuple[dict[str, str | bytes], tuple[str, ...]]:
    """The file beside isolator.c and isolator.py, and what the card says of it."""
    return {name: template(name) for name in NAMES}, (
        "isolator_drake.py: IsolatorSystem, input motion (m, m/s, m/s2), output force (N); its memory is discrete "
        "state, updated every step_s",
    )
