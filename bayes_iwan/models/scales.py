"""A campaign's own orders of magnitude, which make parameters dimensionless and priors weakly informative."""

from dataclasses import dataclass

from bayes_iwan.screen import on_screen


@dataclass(frozen=True)
class Reference:
    """The campaign's own scales, which make α's parameters dimensionless: largest amplitude (mm) and speed (m/s)."""

    length_mm: float
    speed_m_s: float


@dataclass(frozen=True)
@on_screen
class Scales:
    """What the loops themselves say of the orders of magnitude; used for priors and for relative errors.

    Attributes
    ----------
    length_mm
        largest amplitude.
    speed_m_s
        largest speed.
    force_N
        largest RMS force about its mean.
    slip_N
        largest dissipated energy / (4 amplitude): the mean slip force, were all to slip.
    soft_N_mm
        secant stiffness of the largest amplitude.
    stiff_N_mm
        stiffness after reversals, at least.

    Examples
    --------
    >>> import bayes_iwan as bi
    >>> bi.Scales(1.0, 0.063, 10.0, 1.2, 6.0, 14.0).reference.length_mm
    1.0
    """

    length_mm: float
    speed_m_s: float
    force_N: float
    slip_N: float
    soft_N_mm: float
    stiff_N_mm: float

    @property
    def reference(self) -> Reference:
        """Length and speed that the laws of the normal force refer to."""
        return Reference(self.length_mm, self.speed_m_s)
