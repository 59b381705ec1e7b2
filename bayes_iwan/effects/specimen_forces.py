"""Effects inside the specimen that add a force of their own, beside friction and the parallel spring."""

import numpy as np

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.effects.base import Effect, ExtraParameter, Motion, filtered, form
from bayes_iwan.effects.law_families import about, lognormal, power_of


class _AddedForce(Effect):
    """An effect that adds a force of its own parameters and the motion alone."""

    def added_N(self, motion: Motion, own: ParameterValues) -> Array:
        """(draws, loops, samples), N."""
        raise NotImplementedError

    def force(self, force_N: Array, motion: Motion, parameter_values: ParameterValues) -> Array:
        return force_N + self.own(lambda own: self.added_N(motion, own), motion, parameter_values)


class ViscousDamping(_AddedForce):
    name = "viscous_damping"
    needs_clock = True
    # p = 2 is omitted: the drag of fluid pushed through a gap is another mechanism
    law = (
        "c·|v|·((1 + (v/v₁)²)/(1 + (v_ref/v₁)²))^((p − 1)/2)·(sgn v + s), v_ref the campaign's largest speed; p = 1: "
        "a force proportional to velocity, v₁ → 0: to its power p; s = ±1: a valve that damps one way only"
    )
    strength = ("c_N_s_mm", "c", "N·s/mm", "viscous coefficient (secant, at the campaign's largest speed)")
    physics = (
        "A force that grows with velocity beside the friction: oil, grease, squeezed air, or the matrix of the "
        "polymer at frequencies well above its relaxation."
    )
    reference = (
        "Inman, Engineering Vibration, §1.3 (p = 1); Symans & Constantinou, ISET J. Earthq. Technol. 35 (1998) 185; "
        "Lee & Taylor, Struct. Des. Tall Build. 10 (2001) 311 (fluid dampers are built with p = 0.3 to 1.95); Carreau, "
        "Trans. Soc. Rheol. 16 (1972) 99 (thinning from v₁ on); Dixon, The Shock Absorber Handbook, ch. 7 (bump and "
        "rebound damp differently)"
    )
    signature = "quadrature force at the fundamental ∝ frequency × amplitude; loops grow fatter with frequency"
    look_alikes = ("maxwell_branch", "channel_delay", "force_lowpass", "rate_strengthening", "integration_highpass")
    bench = "the same tests at a frequency three times as high; a dummy elastic spring to see the channels' own phase"
    remedy = "Give the model a dashpot of this coefficient, or take the grease away."

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N / (1e3 * self.scales.speed_m_s)

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        what = "speed from which the power holds, below it the force is proportional to the speed"
        return {
            "exponent": form("p", "power of the speed", lognormal(0.8, 0.4), 0.2, 1.65),
            "thinning_m_s": ExtraParameter("v₁", "m/s", what, lognormal(0.1 * self.scales.speed_m_s, 1.5), scan=False),
            "one_way": form("s", "difference of rising and falling u over their sum", about(0.0, 0.25), -1.0, 1.0),
        }

    def added_N(self, motion: Motion, own: ParameterValues) -> Array:
        top = self.scales.speed_m_s
        from_m_s = self.get(own, "thinning_m_s")
        thinned = (from_m_s**2 + motion.speed_m_s**2) / (from_m_s**2 + top**2)
        grown = motion.speed_m_s / top * power_of(thinned, 0.5 * (self.get(own, "exponent") - 1.0))
        way = np.sign(motion.velocity_m_s) + self.get(own, "one_way")
        return (self.get(own, "c_N_s_mm") * 1e3 * top) * way * grown


class MaxwellBranch(_AddedForce):
    name = "maxwell_branch"
    needs_clock = True
    law = "k·(iωτ)^a/(1 + (iωτ)^a); a = 1: one relaxation time, less: a spread of them (fractional Maxwell)"
    strength = ("k_N_mm", "k_m", "N/mm", "stiffness of the branch")
    physics = (
        "A spring and a dashpot in series beside the others: the polymer rope creeps, so part of its stiffness "
        "acts only above the frequency 1/(2πτ)."
    )
    reference = (
        "Ferry, Viscoelastic Properties of Polymers, ch. 1 (one time); Cole & Cole, J. Chem. Phys. 9 (1941) 341, and "
        "Bagley & Torvik, J. Rheol. 27 (1983) 201 (spread of times)"
    )
    signature = "in-phase and quadrature force ∝ amplitude with a knee at 1/(2πτ); fundamental only for a sine"
    look_alikes = ("viscous_damping", "force_highpass", "integration_highpass")
    bench = "a test ten times slower than the slowest, where the branch is relaxed, or a step and hold"
    remedy = "Give the model a relaxing branch, or quote stiffness and loss for the frequency of use."

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N / self.scales.length_mm

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        radian_s = 1e-3 * self.scales.length_mm / self.scales.speed_m_s
        return {
            "tau_s": ExtraParameter(
                "τ", "s", "relaxation time", lognormal(1.5 * radian_s, 1.2), 0.02 * radian_s, 150.0 * radian_s
            ),
            # beyond order 1 such a branch would ring as a mass does
            "spread": form("a", "fractional order: 1 one relaxation time, less a spread", about(1.0, 0.2), 0.3, 1.0),
        }

    def added_N(self, motion: Motion, own: ParameterValues) -> Array:
        tau, order = self.get(own, "tau_s"), self.get(own, "spread")

        def response(f: Array) -> Array:
            s = power_of(2.0 * np.pi * f * tau, order) * np.exp(0.5j * np.pi * order)
            return np.where(f > 0.0, s / (1.0 + s), 0.0)

        return self.get(own, "k_N_mm") * filtered(motion.displacement_mm, motion, response)


class MovingMass(_AddedForce):
    name = "moving_mass"
    needs_clock = True
    law = "m·ü/(1 − r² + 2iζr), r = f/f_m of the mount that holds the mass, ζ its damping; f_m → ∞: m·ü"
    strength = ("m_kg", "m", "kg", "mass between specimen and force cell")
    order = 1
    physics = (
        "Whatever moves between the specimen and the cell's sensing element, fixture and part of the specimen "
        "included, needs a force m·ü that the cell reads as if the specimen made it."
    )
    reference = "Ewins, Modal Testing, §3.4 (mass cancellation); Inman, Engineering Vibration, §2.4 (base excitation)"
    signature = "in-phase force falling with frequency squared; no work unless its mount damps"
    look_alikes = ("maxwell_branch",)
    bench = "a run of the bare fixture; a known mass added"
    remedy = "Take m·ü of the bare fixture off the force, or put the cell on the side that does not move."

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N * self.scales.length_mm * 1e-3 / self.scales.speed_m_s**2

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        top_hz = 1e3 * self.scales.speed_m_s / (2.0 * np.pi * self.scales.length_mm)
        return {
            "period_s": ExtraParameter(
                "1/f_m", "s", "natural period of the mass on its mount", lognormal(0.07 / top_hz, 1.1)
            ),
            "damping": form("ζ", "damping ratio of the mount", lognormal(0.12, 0.8), 0.0, 1.0),
        }

    def added_N(self, motion: Motion, own: ParameterValues) -> Array:
        period, damping = self.get(own, "period_s"), self.get(own, "damping")

        def response(f: Array) -> Array:
            r = f * period
            return 1.0 / (1.0 - r * r + 2j * damping * r)

        return self.get(own, "m_kg") * filtered(motion.acceleration_m_s2, motion, response)


class QuadraticStiffness(_AddedForce):
    name = "quadratic_stiffness"
    law = (
        "k₂·ℓ²·|u/ℓ|^n·(1 + b·sgn u), ℓ the campaign's largest amplitude; n = 2: quadratic, b = ±1: on one side alone, "
        "n → 1: two slopes"
    )
    strength = ("k2_N_mm2", "k₂", "N/mm²", "quadratic stiffness (the force at u = ℓ over ℓ²)")
    signed = True
    physics = "The parallel spring is asymmetric: coils that touch on one side, or a preload off the middle."
    reference = "Nayfeh & Mook, Nonlinear Oscillations, §2.3; Kovacic & Brennan, The Duffing Equation"
    signature = "second harmonic in phase ∝ amplitude squared, at every frequency alike; no work"
    look_alikes = ("end_stop", "direction_dependent_friction")
    bench = "the same tests about a shifted mid-position"
    remedy = "Mount the specimen in its middle position, or give the model's spring an even term."

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N / self.scales.length_mm**2

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            "exponent": form("n", "power of |u|", about(2.0, 0.4), 1.05, 2.95),
            "one_sided": form("b", "0: both sides alike, ±1: one side alone", about(0.0, 0.4), -1.2, 1.2),
        }

    def added_N(self, motion: Motion, own: ParameterValues) -> Array:
        length, u = self.scales.length_mm, motion.displacement_mm
        grown = power_of(u / length, self.get(own, "exponent"))
        side = 1.0 + self.get(own, "one_sided") * np.sign(u)
        return (self.get(own, "k2_N_mm2") * length**2) * grown * side


class CubicStiffness(_AddedForce):
    name = "cubic_stiffness"
    law = "k₃·ℓ³·|u/ℓ|^n·sgn u, ℓ the campaign's largest amplitude; n = 3: cubic"
    strength = ("k3_N_mm3", "k₃", "N/mm³", "cubic stiffness (the force at u = ℓ over ℓ³)")
    signed = True
    physics = "The parallel spring hardens or softens symmetrically with stretch (geometry, coil contact, rubber)."
    reference = (
        "Kovacic & Brennan, The Duffing Equation, ch. 2; Mickens, Truly Nonlinear Oscillations, ch. 1 (other powers)"
    )
    signature = "in-phase first and third harmonics ∝ amplitude cubed, at every frequency alike; no work"
    look_alikes = ("end_stop", "force_clipping")
    bench = "larger amplitudes"
    remedy = "Give the model's spring a hardening term, or use it within the smaller strokes."

    def first_guess(self) -> float:
        return 0.1 * self.scales.slip_N / self.scales.length_mm**3

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {"exponent": form("n", "power of |u|", about(3.0, 0.7), 1.3, 4.7)}

    def added_N(self, motion: Motion, own: ParameterValues) -> Array:
        length, u = self.scales.length_mm, motion.displacement_mm
        grown = np.sign(u) * power_of(u / length, self.get(own, "exponent"))
        return (self.get(own, "k3_N_mm3") * length**3) * grown


class TrilinearStiffness(CubicStiffness):
    law = "k₃·ℓ³·g(|u|/ℓ)/g(1)·sgn u, g: two slopes that meet at x₀ within a width w; w → 0: trilinear"
    reference = (
        "Natsiavas, J. Sound Vib. 134 (1989) 315 (symmetric trilinear springs); Shaw & Holmes, ibid. 90 (1983) 129"
    )
    signature = "in-phase odd harmonics that begin at one stretch, at every frequency alike; no work"

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        return {
            "knee": ExtraParameter("x₀", "-", "where the slope changes, over ℓ", about(0.5, 0.25), 0.05, 0.95),
            "width": form("w", "half width of the change of slope, over ℓ", lognormal(0.1, 0.7), 0.01, 0.6),
        }

    def added_N(self, motion: Motion, own: ParameterValues) -> Array:
        length, u = self.scales.length_mm, motion.displacement_mm
        knee, width = self.get(own, "knee"), self.get(own, "width")

        def beyond(x: Array) -> Array:
            """Rounded max(x − x₀, 0), its value and its slope at 0 taken off, for these are the linear spring's."""
            hard = np.logaddexp(0.0, (x - knee) / width) - np.logaddexp(0.0, -knee / width)
            return width * hard - x / (1.0 + np.exp(knee / width))

        shape = np.sign(u) * beyond(np.abs(u) / length) / beyond(np.ones(1))
        return (self.get(own, "k3_N_mm3") * length**3) * shape


class _Contact(_AddedForce):
    """A contact beyond a clearance: k·p·(d/p)^e·(1 + λ ḋ) of the way d into it, its secant stiffness k at d = p, a
    tenth of ℓ."""

    name = "end_stop"
    sudden = True
    physics = "Beyond a displacement the moving part meets a stop, a coil closes, or the rope's end is reached."
    reference = (
        "Shaw & Holmes, J. Sound Vib. 90 (1983) 129 (e = 1); Johnson, Contact Mechanics, ch. 4, and Hunt & Crossley, "
        "J. Appl. Mech. 42 (1975) 440 (e = 3/2 for round bodies; the loss)"
    )
    look_alikes = ("cubic_stiffness", "quadratic_stiffness")
    bench = "amplitudes just below and above the clearance"
    remedy = "Keep the stroke below the clearance, or move the stop."

    def first_guess(self) -> float:
        return self.scales.slip_N / self.scales.length_mm

    def extra_parameters(self) -> dict[str, ExtraParameter]:
        a, loss = self.scales.length_mm, "loss of the contact: its force grows by λ times the speed into it"
        return {
            "clearance_mm": ExtraParameter(
                "g", "mm", "displacement at which contact begins", lognormal(0.75 * a, 0.35), 0.02 * a, 0.99 * a
            ),
            "exponent": form(
                "e", "exponent of the contact: 1 a spring, 3/2 round bodies", lognormal(1.2, 0.22), 0.8, 2.5
            ),
            "loss_s_m": ExtraParameter("λ", "s/m", loss, lognormal(0.1 / self.scales.speed_m_s, 1.2), scan=False),
        }

    def push_N(self, into_mm: Array, speed_m_s: Array, parameter_values: ParameterValues) -> Array:
        """Force of the contact without its sign, `into_mm` beyond the clearance (negative: none) at a speed into it;
        a contact does not pull."""
        scale = 0.1 * self.scales.length_mm
        push = scale * power_of(np.maximum(into_mm, 0.0) / scale, self.get(parameter_values, "exponent"))
        return push * np.maximum(1.0 + self.get(parameter_values, "loss_s_m") * speed_m_s, 0.0)


class EndStop(_Contact):
    law = "a contact on one side, k·p·(d/p)^e·(1 + λḋ) beyond the clearance; e = 1: a spring, 3/2: Hertz"
    strength = ("k_N_mm", "k_s", "N/mm", "stiffness of the contact; negative: the stop is on the side u < −clearance")
    signed = True
    signature = "nothing below the clearance; beyond it a one-sided force, all harmonics in phase, at all frequencies"

    def added_N(self, motion: Motion, own: ParameterValues) -> Array:
        k = self.get(own, "k_N_mm")
        side = np.where(k < 0.0, -1.0, 1.0)
        into = side * motion.displacement_mm - self.get(own, "clearance_mm")
        return k * self.push_N(into, side * motion.velocity_m_s, own)


class EndStops(_Contact):
    law = "contacts on both sides, k·p·(d/p)^e·(1 + λḋ) beyond the clearance on each; e = 1: springs, 3/2: Hertz"
    strength = ("k_N_mm", "k_s", "N/mm", "stiffness of the contacts")
    signature = "nothing in mid-stroke; beyond the clearance odd harmonics in phase, at every frequency alike"

    def added_N(self, motion: Motion, own: ParameterValues) -> Array:
        u = motion.displacement_mm
        into = np.abs(u) - self.get(own, "clearance_mm")
        return self.get(own, "k_N_mm") * np.sign(u) * self.push_N(into, np.sign(u) * motion.velocity_m_s, own)


EFFECTS: tuple[type[Effect], ...] = (
    ViscousDamping,
    MaxwellBranch,
    MovingMass,
    QuadraticStiffness,
    CubicStiffness,
    TrilinearStiffness,
    EndStop,
    EndStops,
)
