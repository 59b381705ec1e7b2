"""The virtual rig's motion, integrated in time: one compiled function, nothing shared with the fitted model.

From left to right: armature — (shaker's and fixture's compliance, play) — specimen's end — specimen — base.
At every step the position of the specimen's end is solved for, so that the force in the link equals the
specimen's force (Newton's method on a function made of straight pieces, with bisection in reserve).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

Floats = np.ndarray[Any, np.dtype[np.float64]]


class Numbers(NamedTuple):
    """All that the kernel needs beside the drive and the sliders. A value of 0 switches an effect off.

    Lengths in mm, forces in N, times in s; slip speeds in mm/s; λ in s/m as in Eq. (11).
    """

    # specimen
    amplitude_mm: float
    parallel: float
    contact: float
    curve: float
    curve_power: float
    kn: float
    beta: float
    lam: float
    tip: float
    # link between armature and specimen
    link_compliance: float
    play: float = 0.0
    end_mass_kg: float = 0.0
    end_damping: float = 0.0
    # the specimen's own further forces
    viscous: float = 0.0
    drag: float = 0.0
    maxwell_k: float = 0.0
    maxwell_tau: float = 1.0
    k2: float = 0.0
    k3: float = 0.0
    stop_gap: float = 1e9
    stop_k: float = 0.0
    stop_loss_s_m: float = 0.0
    hertz_gap: float = 1e9
    hertz_k: float = 0.0
    # friction
    rate_drop: float = 0.0
    rate_drop_speed: float = 1.0
    rate_rise: float = 0.0
    rate_rise_speed: float = 1.0
    ageing: float = 0.0
    ageing_tau: float = 1.0
    ageing_slip: float = 1.0
    normal_lag: float = 0.0
    fade_drop: float = 0.0
    fade_cycles: float = 1.0
    direction: float = 0.0
    groove: float = 0.0
    groove_pitch: float = 1.0
    groove_phase: float = 0.0
    rocking: float = 0.0
    heat_loss_1_mW: float = 0.0
    heat_tau: float = 1.0
    # base
    base_k: float = 0.0
    base_mass_kg: float = 1.0
    base_damping_ratio: float = 0.0


@njit(cache=True)
def march(
    drive: Floats, cycle: Floats, h: float, share: Floats, slip: Floats, q: Numbers
) -> tuple[Floats, Floats, Floats]:
    """Integrate the rig from rest.

    Parameters: `drive` (n,) armature position in mm at steps of `h` seconds; `cycle` (n,) cycles since the
    start of the record (negative while running in); `share`, `slip` (m,) the sliders' shares of the stiffness
    and of the slip force (N). Returns the force in the link (n,), the specimen's deformation in mm (n,)
    and the work lost in slip up to each step (n,), in N·mm.
    """
    n, m = drive.size, share.size
    force, deformation, lost = np.zeros(n), np.zeros(n), np.zeros(n)
    x = np.zeros(m)  # slider positions
    own = np.ones(m)  # a slider's own factor on its slip force
    slope = np.zeros(m)  # change of the own factor per unit of remembered slip speed
    speed = np.zeros(m)  # remembered slip speed of each slider
    memory = np.zeros(m)  # its memory time
    bond = np.ones(m)
    rated = q.rate_drop != 0.0 or q.rate_rise != 0.0
    aged = q.ageing != 0.0
    if rated:
        # A massless slider whose friction falls with speed runs away unless its memory is longer than
        # |dφ/dv|/k: real contacts have a memory length, and it is taken just above that bound.
        for j in range(m):
            steepest = slip[j] * q.rate_drop / q.rate_drop_speed
            memory[j] = 2e-4 + 1.3 * steepest / (q.contact * share[j])
    k_norm = 1.0 - np.exp(-q.curve)
    log_a = np.log(q.amplitude_mm)
    maxwell, alpha_lag, glaze, heat = 0.0, 1.0, 0.0, 0.0
    xb, vb = 0.0, 0.0
    z, z1, d_old, z_speed = 0.0, 0.0, 0.0, 0.0
    work = 0.0
    link_k = 1.0 / q.link_compliance
    half_play = 0.5 * q.play
    lag_gain = 1.0 if q.normal_lag == 0.0 else (h / q.normal_lag) / (1.0 + h / q.normal_lag)
    maxwell_gain = 1.0 / (1.0 + h / q.maxwell_tau)
    inertia = q.end_mass_kg * 1e-3 / h**2
    damper = q.end_damping / h
    base_damping = 2.0 * q.base_damping_ratio * np.sqrt(q.base_k * q.base_mass_kg * 1e-3)
    for i in range(n):
        u = drive[i]
        # ---- what changes slowly, taken at the start of the step
        common = 1.0
        if q.fade_drop != 0.0:
            if cycle[i] > 0.0:
                glaze += (1.0 - glaze) * (cycle[i] - cycle[i - 1]) / q.fade_cycles
            common *= 1.0 - q.fade_drop * glaze
        if q.groove != 0.0:
            common *= 1.0 + q.groove * np.sin(2.0 * np.pi * d_old / q.groove_pitch + q.groove_phase)
        if q.rocking != 0.0:
            whole = np.floor(cycle[i])
            if whole % 2.0 != 0.0:
                common *= 1.0 + q.rocking * np.sin(np.pi * (cycle[i] - whole)) ** 2
        soft = 1.0
        if q.heat_loss_1_mW != 0.0:
            soft = max(1.0 - q.heat_loss_1_mW * heat, 0.2)
        if rated:
            for j in range(m):
                own[j], slope[j] = 1.0, 0.0
                if q.rate_drop != 0.0:
                    e = np.exp(-speed[j] / q.rate_drop_speed)
                    own[j] -= q.rate_drop * (1.0 - e)
                    slope[j] -= q.rate_drop * e / q.rate_drop_speed
                if q.rate_rise != 0.0:
                    own[j] += q.rate_rise * np.log1p(speed[j] / q.rate_rise_speed)
                    slope[j] += q.rate_rise / (q.rate_rise_speed + speed[j])
        if aged:
            for j in range(m):
                own[j] = 1.0 + q.ageing * bond[j]
        # ---- solve for the end's position
        lo, hi = -1e9, 1e9
        trial = z + (u - (drive[i - 1] if i > 0 else 0.0)) if q.play == 0.0 else z + h * z_speed
        total = alpha = k = link = d = 0.0
        for iteration in range(60):
            d = trial - xb
            v = (d - d_old) / h
            gap = q.amplitude_mm - d
            y = np.sqrt(gap * gap + (q.tip * q.amplitude_mm) ** 2)
            yb = np.exp(q.beta * np.log(y))
            pull = q.lam * q.kn * yb * gap / y * 1e-3
            alpha_now = 1.0 + q.kn * (yb - np.exp(q.beta * log_a)) + pull * abs(v)
            alpha = alpha_lag + lag_gain * (alpha_now - alpha_lag)
            dalpha = lag_gain * pull * (1.0 if v >= 0.0 else -1.0) / h
            if alpha < 0.05:
                alpha, dalpha = 0.05, 0.0
            decay = np.exp(-q.curve * alpha**q.curve_power)
            k = soft * q.contact * (1.0 - decay) / k_norm
            k_log_slope = decay * q.curve * q.curve_power * alpha ** (q.curve_power - 1.0) / (1.0 - decay)
            limit = alpha * common
            stuck_k = stuck_f = slid_f = slid_k = 0.0
            if rated or aged:
                for j in range(m):
                    kj = k * share[j]
                    fj = kj * (d - x[j])
                    sign = 1.0 if fj > 0.0 else -1.0
                    base = limit * slip[j] * (1.0 + sign * q.direction)
                    if abs(fj) <= base * own[j]:
                        stuck_k += share[j]
                        stuck_f += fj
                    elif aged:
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
                plus, minus = limit * (1.0 + q.direction), -limit * (1.0 - q.direction)
                for j in range(m):
                    fj = k * share[j] * (d - x[j])
                    if fj > plus * slip[j]:
                        slid_f += plus * slip[j]
                    elif fj < minus * slip[j]:
                        slid_f += minus * slip[j]
                    else:
                        stuck_f += fj
                        stuck_k += share[j]
            total = stuck_f + slid_f + soft * q.parallel * d
            tangent = k * stuck_k + soft * q.parallel + slid_k
            tangent += (stuck_f * k_log_slope + slid_f / alpha) * dalpha
            total += q.viscous * v + q.drag * v * abs(v) + q.k2 * d * d + q.k3 * d**3
            tangent += q.viscous / h + 2.0 * q.drag * abs(v) / h + 2.0 * q.k2 * d + 3.0 * q.k3 * d * d
            if q.maxwell_k != 0.0:
                total += q.maxwell_k * (d - maxwell) * maxwell_gain
                tangent += q.maxwell_k * maxwell_gain
            if d > q.stop_gap:
                total += q.stop_k * (d - q.stop_gap) * max(1.0 + q.stop_loss_s_m * 1e-3 * v, 0.0)
                tangent += q.stop_k
            if abs(d) > q.hertz_gap:
                deep = abs(d) - q.hertz_gap
                total += (1.0 if d > 0.0 else -1.0) * q.hertz_k * deep**1.5
                tangent += 1.5 * q.hertz_k * np.sqrt(deep)
            # link: nothing is carried within the play
            stretch = u - trial
            if stretch > half_play:
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
        alpha_lag = alpha
        slipped = 0.0
        for j in range(m):
            kj = k * share[j]
            fj = kj * (d - x[j])
            sign = 1.0 if fj > 0.0 else -1.0
            base = limit * slip[j] * (1.0 + sign * q.direction)
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
                if aged:
                    reach = max(q.ageing_slip, 1.5 * q.ageing * base / kj)  # else a slider would jump
                    bond[j] *= np.exp(-abs(moved) / reach)
            elif rated:
                speed[j] *= memory[j] / (memory[j] + h)
            if aged:
                bond[j] += (1.0 - bond[j]) * h / (q.ageing_tau + h)
        work += slipped
        if q.maxwell_k != 0.0:
            maxwell = (maxwell + h / q.maxwell_tau * d) * maxwell_gain
        if q.heat_loss_1_mW != 0.0:
            heat += (slipped / h - heat) * h / q.heat_tau
        if q.base_k != 0.0:  # 1 N on 1 kg is 1000 mm/s²
            vb += h * (total - q.base_k * xb - base_damping * vb) / (q.base_mass_kg * 1e-3)
            xb += h * vb
        z_speed = (trial - z) / h
        z1, z = z, trial
        d_old = d
        force[i], deformation[i], lost[i] = link, d, work
    return force, deformation, lost
