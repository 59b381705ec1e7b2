"""The virtual rig's motion, integrated in time: one compiled function, nothing shared with the fitted model.

From left to right: armature — (shaker's compliance with a loss, fixture's compliance, play) — specimen's end —
specimen — base.
At every step the position of the specimen's end is solved for, so that the force in the link equals the
specimen's force (Newton's method on a function made of straight pieces, with bisection in reserve).
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from bayes_iwan.arrays import Array

#: stands for a law that is not there
NO_TABLE: Array = np.zeros(1)


class SpecimenValues(NamedTuple):
    """The specimen without its sliders, and the link: lengths in mm, forces in N; λ in s/m as in Eq. (11)."""

    amplitude_mm: float
    parallel: float
    contact: float
    curve: float
    curve_power: float
    kn: float
    beta: float
    lam: float
    tip: float
    # between armature and specimen: what a step's force stretches within the step, the shaker's part of that, and the
    # share of the shaker's stretch that is left from one step to the next
    link_compliance: float
    shaker_compliance: float
    shaker_memory: float


class FaultValues(NamedTuple):
    """What faults change in the motion; 0, or a table of one number, switches one off.

    Lengths in mm, forces in N, times in s; slip speeds in mm/s.
    """

    # link between armature and specimen; `joint` is its force beyond the play where that is no straight line
    play: float = 0.0
    end_mass_kg: float = 0.0
    end_damping: float = 0.0
    joint: Array = NO_TABLE
    joint_step: float = 1.0
    # the specimen's own further forces: tables over displacement and speed, and what remembers
    displacement_force: Array = NO_TABLE
    displacement_step: float = 1.0
    speed_force: Array = NO_TABLE
    speed_step: float = 1.0
    branch_k: Array = NO_TABLE
    branch_tau: Array = NO_TABLE
    stop_gap: float = 1e9
    stop_k: float = 0.0
    stop_power: float = 1.0
    stop_loss_s_m: float = 0.0
    # friction; `rate` is a slider's factor over its remembered slip speed
    rate: Array = NO_TABLE
    rate_step: float = 1.0
    ageing: float = 0.0
    ageing_tau: float = 1.0
    ageing_slip: float = 1.0
    healing: float = 0.0
    healing_time: float = 1.0
    healing_cut: float = 1.0
    healing_slip: float = 1.0
    lag_rise_s: float = 0.0
    lag_fall_s: float = 0.0
    lag_second_s: float = 0.0
    lag_slow_share: float = 0.0
    lag_slow_s: float = 1.0
    lag_slower_s: float = 1.0
    lag_quick: float = 0.0
    fade: Array = NO_TABLE
    fade_step: float = 1.0
    fade_work_Nmm: float = 0.0
    fade_stiffness: float = 0.0
    direction: float = 0.0
    direction_speed: float = 0.0
    direction_slope_1_mm: float = 0.0
    groove: float = 0.0
    groove_pitch: float = 1.0
    groove_phase: float = 0.0
    position: Array = NO_TABLE
    position_step: float = 1.0
    rocking: float = 0.0
    heat_loss_1_mW: float = 0.0
    heat_fade_1_mW: float = 0.0
    heat_tau: float = 1.0
    warming_1_s: float = 0.0
    warming_tau: float = 1e9
    # base
    base_k: float = 0.0
    base_mass_kg: float = 1.0
    base_damping_ratio: float = 0.0


@njit(cache=True)
def _look_up(table: Array, start: float, step: float, x: float) -> tuple[float, float]:
    """Value and slope of a table over a uniform grid; straight on beyond its ends."""
    place = (x - start) / step
    i = min(max(int(place), 0), table.size - 2)
    slope = (table[i + 1] - table[i]) / step
    return table[i] + slope * (x - start - i * step), slope


# sums may be reordered, so that sliders go several at a time; nan and infinity stay what they are
@njit(cache=True, fastmath={"contract", "reassoc", "nsz", "arcp"})
def march(
    drive: Array, cycle: Array, h: float, share: Array, slip: Array, s: SpecimenValues, q: FaultValues
) -> tuple[Array, Array, Array]:
    """Integrate the rig from rest.

    Parameters: `drive` (n,) armature position in mm at steps of `h` seconds; `cycle` (n,) cycles since the
    start of the record (negative while running in); `share`, `slip` (m,) the sliders' shares of the stiffness
    and of the slip force (N); `s` the specimen's other values, `q` what faults change. Returns the force in the
    link (n,), the specimen's deformation in mm (n,) and the work lost in slip up to each step (n,), in N·mm.
    """
    n, m = drive.size, share.size
    force, deformation, lost = np.zeros(n), np.zeros(n), np.zeros(n)
    x = np.zeros(m)  # slider positions
    own = np.ones(m)  # a slider's own factor on its slip force
    slope = np.zeros(m)  # change of the own factor per unit of remembered slip speed
    rested = np.full(m, q.healing_time)  # age of each slider's contact
    speed = np.zeros(m)  # remembered slip speed of each slider
    memory = np.zeros(m)  # its memory time
    bond = np.ones(m)
    rated = q.rate.size > 1
    aged = q.ageing != 0.0
    healed = q.healing != 0.0
    if rated:
        # A massless slider whose friction falls with speed runs away unless its memory is longer than
        # |dφ/dv|/k: real contacts have a memory length, and it is taken just above that bound.
        steep = max(-np.min(np.diff(q.rate)) / q.rate_step, 0.0)
        for j in range(m):
            steepest = slip[j] * steep
            memory[j] = 2e-4 + 1.3 * steepest / (s.contact * share[j])
    k_norm = 1.0 - np.exp(-s.curve)
    log_a = np.log(s.amplitude_mm)
    alpha_lag, alpha_rate, alpha_was, alpha_slow, alpha_slower, heat = 1.0, 0.0, 1.0, 1.0, 1.0, 0.0
    branch = np.zeros(q.branch_k.size)
    branches = q.branch_k.size if q.branch_k[0] != 0.0 else 0
    branch_gain = 1.0 / (1.0 + h / q.branch_tau) if branches else q.branch_tau
    worked = 0.0
    xb, vb = 0.0, 0.0
    z, z1, d_old, z_speed, kept = 0.0, 0.0, 0.0, 0.0, 0.0
    work = 0.0
    link_k = 1.0 / s.link_compliance
    per_second = (cycle[n - 1] - cycle[0]) / (h * (n - 1))
    half_play = 0.5 * q.play
    lagged = q.lag_rise_s != 0.0
    rise_gain = 1.0 if not lagged else h / (q.lag_rise_s + h)
    fall_gain = 1.0 if not lagged else h / (q.lag_fall_s + h)
    slow_gain, slower_gain = h / (q.lag_slow_s + h), h / (q.lag_slower_s + h)
    # a second-order lag: τ1·τ2·a'' + (τ1 + τ2)·a' + a = α
    whole_healing = np.log1p(q.healing_time / q.healing_cut)
    second = q.lag_second_s
    second_gain = 1.0 / (1.0 + (q.lag_rise_s + second) / h + q.lag_rise_s * second / h**2) if second else 1.0
    displacement_start = -0.5 * (q.displacement_force.size - 1) * q.displacement_step
    speed_start = -0.5 * (q.speed_force.size - 1) * q.speed_step
    position_start = -0.5 * (q.position.size - 1) * q.position_step
    inertia = q.end_mass_kg * 1e-3 / h**2
    damper = q.end_damping / h
    base_damping = 2.0 * q.base_damping_ratio * np.sqrt(q.base_k * q.base_mass_kg * 1e-3)
    for i in range(n):
        u = drive[i]
        # ---- what changes slowly, taken at the start of the step
        common = 1.0
        soft = faded_k = 1.0
        if q.fade.size > 1 and cycle[i] > 0.0:
            travelled = worked / q.fade_work_Nmm if q.fade_work_Nmm != 0.0 else cycle[i]
            faded = _look_up(q.fade, 0.0, q.fade_step, travelled)[0]
            common *= faded
            faded_k = faded**q.fade_stiffness
        if q.groove != 0.0:
            common *= 1.0 + q.groove * np.sin(2.0 * np.pi * d_old / q.groove_pitch + q.groove_phase)
        if q.position.size > 1:
            common *= _look_up(q.position, position_start, q.position_step, d_old)[0]
        if q.rocking != 0.0:
            whole = np.floor(cycle[i])
            if whole % 2.0 != 0.0:
                common *= 1.0 + q.rocking * np.sin(np.pi * (cycle[i] - whole)) ** 2
        if q.warming_1_s != 0.0 and cycle[i] > 0.0:
            warmed = -q.warming_tau * np.expm1(-cycle[i] / per_second / q.warming_tau)
            soft = max(1.0 - q.warming_1_s * warmed, 0.2)
        lean = q.direction
        if q.direction_speed != 0.0:
            lean *= np.tanh(abs(z_speed) / q.direction_speed)
        lean = min(max(lean * (1.0 + q.direction_slope_1_mm * d_old), -0.95), 0.95)
        if q.heat_loss_1_mW != 0.0:
            soft *= max(1.0 - q.heat_loss_1_mW * heat, 0.2)
        if q.heat_fade_1_mW != 0.0:
            common *= max(1.0 - q.heat_fade_1_mW * heat, 0.2)
        if rated:
            for j in range(m):
                own[j], slope[j] = _look_up(q.rate, 0.0, q.rate_step, speed[j])
        if aged:
            for j in range(m):
                own[j] = 1.0 + q.ageing * bond[j]
        if healed:
            for j in range(m):
                own[j] = 1.0 - q.healing * (1.0 - np.log1p(rested[j] / q.healing_cut) / whole_healing)
        if q.lag_quick != 0.0:  # the farther it has to fall, the quicker it does: no exponential
            fall_gain = h / (q.lag_fall_s / (1.0 + q.lag_quick * max(alpha_lag - alpha_was, 0.0)) + h)
        # ---- solve for the end's position
        lo, hi = -1e9, 1e9
        trial = z + (u - (drive[i - 1] if i > 0 else 0.0)) if q.play == 0.0 else z + h * z_speed
        total = alpha = k = link = d = 0.0
        for iteration in range(60):
            d = trial - xb
            v = (d - d_old) / h
            gap = s.amplitude_mm - d
            y = np.sqrt(gap * gap + (s.tip * s.amplitude_mm) ** 2)
            yb = np.exp(s.beta * np.log(y))
            pull = s.lam * s.kn * yb * gap / y * 1e-3
            alpha_now = 1.0 + s.kn * (yb - np.exp(s.beta * log_a)) + pull * abs(v)
            if second != 0.0:
                free = alpha_lag + alpha_rate * h * (q.lag_rise_s * second / h**2) / (
                    (q.lag_rise_s + second) / h + q.lag_rise_s * second / h**2
                )
                alpha = free + second_gain * (alpha_now - free)
                dalpha = second_gain
            else:
                dalpha = rise_gain if alpha_now > alpha_lag else fall_gain
                alpha = alpha_lag + dalpha * (alpha_now - alpha_lag)
            dalpha *= (1.0 - q.lag_slow_share) * pull * (1.0 if v >= 0.0 else -1.0) / h
            fast = alpha
            if q.lag_slow_share != 0.0:
                alpha += q.lag_slow_share * (0.5 * (alpha_slow + alpha_slower) - alpha)
            if alpha < 0.05:
                alpha, dalpha = 0.05, 0.0
            decay = np.exp(-s.curve * alpha**s.curve_power)
            k = soft * faded_k * s.contact * (1.0 - decay) / k_norm
            k_log_slope = decay * s.curve * s.curve_power * alpha ** (s.curve_power - 1.0) / (1.0 - decay)
            limit = alpha * common
            stuck_k = stuck_f = slid_f = slid_k = 0.0
            if rated or aged or healed:
                for j in range(m):
                    kj = k * share[j]
                    fj = kj * (d - x[j])
                    sign = 1.0 if fj > 0.0 else -1.0
                    base = limit * slip[j] * (1.0 + sign * lean)
                    if abs(fj) <= base * own[j]:
                        stuck_k += share[j]
                        stuck_f += fj
                    elif aged or healed:
                        slid_f += sign * base * own[j]
                    else:
                        # remembered speed w and slip together, own factor linear in w over the step
                        rise = base * slope[j]
                        w = (memory[j] * speed[j] + sign * (d - x[j]) - base * (own[j] - slope[j] * speed[j]) / kj) / (
                            memory[j] + h + rise / kj
                        )
                        w = max(w, 0.0)
                        slid_f += sign * base * (own[j] + slope[j] * (w - speed[j]))
                        slid_k += rise / (memory[j] + h + rise / kj)
            else:
                plus, minus = limit * (1.0 + lean), -limit * (1.0 - lean)
                carried = 0.0
                for j in range(m):
                    fj = k * share[j] * (d - x[j])
                    held = min(max(fj, minus * slip[j]), plus * slip[j])
                    sticks = 1.0 if held == fj else 0.0
                    carried += held
                    stuck_f += sticks * fj
                    stuck_k += sticks * share[j]
                slid_f = carried - stuck_f
            total = stuck_f + slid_f + soft * s.parallel * d
            tangent = k * stuck_k + soft * s.parallel + slid_k
            tangent += (stuck_f * k_log_slope + slid_f / alpha) * dalpha
            if q.displacement_force.size > 1:
                more, steeper = _look_up(q.displacement_force, displacement_start, q.displacement_step, d)
                total += more
                tangent += steeper
            if q.speed_force.size > 1:
                more, steeper = _look_up(q.speed_force, speed_start, q.speed_step, v)
                total += more
                tangent += steeper / h
            for b in range(branches):
                total += q.branch_k[b] * (d - branch[b]) * branch_gain[b]
                tangent += q.branch_k[b] * branch_gain[b]
            if d > q.stop_gap:
                pressed = q.stop_k * (d - q.stop_gap) ** q.stop_power
                total += pressed * max(1.0 + q.stop_loss_s_m * 1e-3 * v, 0.0)
                tangent += q.stop_power * pressed / (d - q.stop_gap)
            # link: nothing is carried within the play
            stretch = u - kept - trial
            if q.joint.size > 1 and abs(stretch) > half_play:
                link, link_slope = _look_up(q.joint, 0.0, q.joint_step, abs(stretch) - half_play)
                link *= 1.0 if stretch > 0.0 else -1.0
            elif stretch > half_play:
                link, link_slope = link_k * (stretch - half_play), link_k
            elif stretch < -half_play:
                link, link_slope = link_k * (stretch + half_play), link_k
            else:
                link, link_slope = 0.0, 0.0
            g = total - link
            g_slope = tangent + link_slope
            if q.end_mass_kg != 0.0:
                g += inertia * (trial - 2.0 * z + z1) + damper * (trial - z)
                g_slope += inertia + damper
            if abs(g) < 1e-7:
                break
            if g > 0.0:
                hi = trial
            else:
                lo = trial
            # halve only when both ends are known and Newton leaves them or dawdles
            proposed = trial - g / max(g_slope, 1e-3)
            if (proposed <= lo or proposed >= hi or iteration > 25) and lo > -1e8 and hi < 1e8:
                proposed = 0.5 * (lo + hi)
            if abs(proposed - trial) < 1e-13:
                break
            trial = proposed
        # ---- accept the step
        alpha_rate = (fast - alpha_lag) / h
        alpha_lag = fast
        alpha_slow += slow_gain * (alpha_now - alpha_slow)
        alpha_slower += slower_gain * (alpha_now - alpha_slower)
        alpha_was = alpha_now
        slipped = 0.0
        if not (rated or aged or healed):
            plus, minus = limit * (1.0 + lean), -limit * (1.0 - lean)
            for j in range(m):
                kj = k * share[j]
                fj = kj * (d - x[j])
                held = min(max(fj, minus * slip[j]), plus * slip[j])
                moved = (fj - held) / kj
                x[j] += moved
                slipped += held * moved
        else:
            for j in range(m):
                kj = k * share[j]
                fj = kj * (d - x[j])
                sign = 1.0 if fj > 0.0 else -1.0
                base = limit * slip[j] * (1.0 + sign * lean)
                top = base * own[j]
                if abs(fj) > top:
                    if rated:
                        rise = base * slope[j]
                        w = (memory[j] * speed[j] + sign * (d - x[j]) - base * (own[j] - slope[j] * speed[j]) / kj) / (
                            memory[j] + h + rise / kj
                        )
                        w = max(w, 0.0)
                        top = base * (own[j] + slope[j] * (w - speed[j]))
                        speed[j] = w
                    moved = d - sign * top / kj - x[j]
                    x[j] += moved
                    slipped += sign * top * moved
                    if healed:
                        reach = max(q.healing_slip, 1.5 * q.healing * base / kj)
                        rested[j] /= 1.0 + abs(moved) / reach
                    if aged:
                        reach = max(q.ageing_slip, 1.5 * q.ageing * base / kj)  # else a slider would jump
                        bond[j] *= np.exp(-abs(moved) / reach)
                elif rated:
                    speed[j] *= memory[j] / (memory[j] + h)
                if healed:
                    rested[j] = min(rested[j] + h, q.healing_time)
                if aged:
                    bond[j] += (1.0 - bond[j]) * h / (q.ageing_tau + h)
        work += slipped
        if cycle[i] > 0.0:
            worked += slipped
        for b in range(branches):
            branch[b] = (branch[b] + h / q.branch_tau[b] * d) * branch_gain[b]
        if q.heat_loss_1_mW != 0.0 or q.heat_fade_1_mW != 0.0:
            heat += (slipped / h - heat) * h / q.heat_tau
        if q.base_k != 0.0:  # 1 N on 1 kg is 1000 mm/s²
            vb += h * (total - q.base_k * xb - base_damping * vb) / (q.base_mass_kg * 1e-3)
            xb += h * vb
        z_speed = (trial - z) / h
        z1, z = z, trial
        d_old = d
        kept = s.shaker_memory * (kept + s.shaker_compliance * link)
        force[i], deformation[i], lost[i] = link, d, work
    return force, deformation, lost
