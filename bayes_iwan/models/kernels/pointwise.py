"""Compiled laws that take each sample, or each draw, on its own: Eq. (11) for α, Eq. (12) for k and its ratio.

The laws need one exponential a sample. The C library's costs some 4 ns and cannot be vectorised; the polynomial below
can: with the C library's, α takes 3.8 to 5.2 times as long, k 5.5 times, a whole call 1.8 to 2.1 times (an AMD EPYC,
analyses/benchmark_side_by_side.py against a tree with math.exp, expm1 and log in their place). The functions
call each other, so they stay in one file.
"""

import math

import numba as nb
import numpy as np

from bayes_iwan.models.kernels.vectors import apart_and_wide

_jit = nb.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
#: share added to the squares of vectors, so that those that are nearly others get no large weights against each other
_DAMPED = 1e-12


@_jit
def _parts(x):
    """2ⁿ and 2ⁿ(e^r − 1) of e^x, |r| ≤ ½ ln 2, to 1e-14 relative for |x| < 700 (saturating beyond)."""
    near = x if x > -700.0 else -700.0  # NaN comes out of the comparisons as a number, and is put back below
    near = near if near < 700.0 else 700.0
    shifted = near * 1.4426950408889634 + 6755399441055744.0  # 1.5·2⁵²: n, rounded, stands in its last bits
    n = shifted - 6755399441055744.0
    r = (near - n * 0.693147180369123816490) - n * 1.90821492927058770002e-10  # ln 2 in two parts
    # (e^r − 1 − r)/r² on |r| ≤ ½ ln 2, to 1e-16, by the polynomial of degree 9 that errs least (mpmath.chebyfit)
    q = 2.51003758325612337e-8
    q = q * r + 2.76200758799833666e-7
    q = q * r + 2.75572684803100255e-6
    q = q * r + 2.48015213223686933e-5
    q = q * r + 1.98412698630405453e-4
    q = q * r + 1.38888889171967191e-3
    q = q * r + 8.33333333333006445e-3
    q = q * r + 4.16666666666241619e-2
    q = q * r + 0.166666666666666675
    q = q * r + 0.500000000000000102
    q = q * r + 1.0
    power = np.int64((np.float64(shifted).view(np.int64) + 1023) << 52).view(np.float64)
    return power, power * r * q + 0.0 * x


@_jit
def _expm1(x):
    """e^x − 1, as exact as :func:`_parts`."""
    power, remainder = _parts(x)
    return (power - 1.0) + remainder


@_jit
def _exp(x):
    """e^x, as exact as :func:`_parts`."""
    power, remainder = _parts(x)
    return power + remainder


@_jit
def hunt_crossley(log_y, log_a, zero, speed, slope, rate, beta, floor, out):
    """α = max(1 + slope·((y/ℓ)^β − (A/ℓ)^β)/β + rate·(y/ℓ)^β·speed, floor) into out (draws, loops, samples).

    log_y, speed : (1 or draws, loops, samples); log_a : (loops,); zero = ln ℓ; slope, rate, beta : (draws,).
    """
    apart_and_wide()
    for d in range(out.shape[0]):
        m = d % log_y.shape[0]
        b = beta[d] if not abs(beta[d]) < 1e-12 else 1e-12  # at β = 0 the law is its limit, a logarithm
        for j in range(out.shape[1]):
            at_rest = math.exp(b * (log_a[j] - zero))
            rise_slope, drag = slope[d] * at_rest / b, rate[d] * at_rest
            for i in range(out.shape[2]):
                rise = _expm1(b * (log_y[m, j, i] - log_a[j]))  # (y/A)^β − 1, free of cancellation as β → 0
                alpha = 1.0 + rise_slope * rise + drag * (1.0 + rise) * speed[m, j, i]
                out[d, j, i] = floor if alpha < floor else alpha  # NaN stays NaN


@_jit
def saturating(alpha, final, ratio, out):
    """k = final·(1 − exp(−ratio·α)) into out, shaped as alpha (draws, loops, samples); final, ratio : (draws,)."""
    apart_and_wide()
    for d in range(out.shape[0]):
        for j in range(out.shape[1]):
            for i in range(out.shape[2]):
                out[d, j, i] = -final[d] * _expm1(-ratio[d] * alpha[d, j, i])


@_jit
def _log(x):
    """ln x to 1e-15 absolute or relative for x > 0: exponent and 2·artanh((m − 1)/(m + 1)), √½ ≤ m < √2, by series.

    The exponent is shifted as an unsigned number and read from a mantissa's last bits: vectors of 256 bits can do both.
    """
    bits = np.float64(x).view(np.uint64)
    up = (bits + np.uint64(0x00095F619980C433)) >> np.uint64(52)  # the exponent of x/√½, 1023 added
    n = np.uint64(up | np.uint64(0x4330000000000000)).view(np.float64) - (4503599627370496.0 + 1023.0)
    m = np.uint64(bits - (up << np.uint64(52)) + np.uint64(0x3FF0000000000000)).view(np.float64)
    s = (m - 1.0) / (m + 1.0)
    y = s * s
    q = 1.0 / 21.0
    q = q * y + 1.0 / 19.0
    q = q * y + 1.0 / 17.0
    q = q * y + 1.0 / 15.0
    q = q * y + 1.0 / 13.0
    q = q * y + 1.0 / 11.0
    q = q * y + 1.0 / 9.0
    q = q * y + 1.0 / 7.0
    q = q * y + 0.2
    q = q * y + 1.0 / 3.0
    found = n * 0.6931471805599453 + 2.0 * s * (1.0 + y * q)
    return found if x == x else x  # the bits of a NaN would pass for a number's


@_jit
def times_power(k, alpha, exponent):
    """k·α^exponent into k, shaped as alpha > 0 (draws, loops, samples); exponent : (draws,), 0 leaves k bit for bit."""
    apart_and_wide()
    for d in range(k.shape[0]):
        if exponent[d] == 0.0:
            continue
        for j in range(k.shape[1]):
            for i in range(k.shape[2]):
                k[d, j, i] += k[d, j, i] * _expm1(exponent[d] * _log(alpha[d, j, i]))


@_jit
def times_exponential(alpha, shape, size):
    """α·exp(size·shape) into alpha (draws, loops, samples); shape : (1 or draws, loops, samples), size : (draws,)."""
    apart_and_wide()
    for d in range(alpha.shape[0]):
        m = d % shape.shape[0]
        for j in range(alpha.shape[1]):
            for i in range(alpha.shape[2]):
                alpha[d, j, i] += alpha[d, j, i] * _expm1(size[d] * shape[m, j, i])


@_jit
def solve_elasticity(value, out):
    """The z > 0 at which z/(e^z − 1) is value, in (0, 1), by Newton's method on the logarithm; (draws,)."""
    for d in range(out.size):
        target = math.log(value[d])
        # close starts at both ends: z ≈ 2(1 − ε) for ε → 1, z ≈ −ln ε + ln z for ε → 0
        z = 2.0 * (1.0 - value[d]) if value[d] > 0.5 else -target + math.log(max(1.5 - target, 1.0))
        z = max(z, 1e-9)
        for _ in range(30):
            growth = _expm1(z)
            slope = 1.0 / z - (growth + 1.0) / growth
            step = (math.log(z / growth) - target) / (slope if slope != 0.0 else -0.5)
            z = max(z - step, 0.1 * z)
            if not abs(step) > 1e-14 * z:
                break
        out[d] = z + 0.0 * value[d]  # NaN stays NaN


#: what stands for zero in a logarithm
_LEAST = 1e-300
#: below this a parameter that changes a law's form is taken as zero: the limit itself, free of cancellation
_NONE = 1e-7


@_jit
def power(x, exponent, out):
    """|x|^p into out (draws, samples), 0 (all but) at x = 0; x : (1 or draws, samples), exponent : (draws,)."""
    apart_and_wide()
    for d in range(out.shape[0]):
        m = d % x.shape[0]
        for i in range(out.shape[1]):
            size = abs(x[m, i])
            out[d, i] = _exp(exponent[d] * _log(_LEAST if size < _LEAST else size))


@_jit
def falling(x, tail, out):
    """(1 + q x)^(−1/q), x ≥ 0, into out (draws, samples), 0 (all but) where 1 + q x < 0; x and tail as x and exponent
    of :func:`power`."""
    apart_and_wide()
    for d in range(out.shape[0]):
        m = d % x.shape[0]
        q = tail[d] if not abs(tail[d]) < _NONE else _NONE
        for i in range(out.shape[1]):
            at = 1.0 + q * x[m, i]
            out[d, i] = _exp(-_log(_LEAST if at < _LEAST else at) / q)


@_jit
def growing(x, power, out):
    """((1 + x)^q − 1)/q, x ≥ 0, into out (draws, samples); x and power as x and exponent of :func:`power`."""
    apart_and_wide()
    for d in range(out.shape[0]):
        m = d % x.shape[0]
        q = power[d] if not abs(power[d]) < _NONE else _NONE
        for i in range(out.shape[1]):
            out[d, i] = _expm1(q * _log(1.0 + x[m, i])) / q


@_jit
def series_step(
    u, compliance, softer, first_N, stiff, force, trial, step, left, slopes, moves, products, passed, held, size
):
    """A pass towards u = trial + g(F), g = C·(F + s·F₁·(1 − e^(−|F|/F₁))·sgn F), by Anderson's mixing of each loop's
    last passes (D. G. Anderson, J. ACM 12, 1965, 547; type II of Fang & Saad, Numer. Linear Algebra Appl. 16, 2009,
    197), where dF/d(trial) is guessed by one stiffness.

    u : (1 or draws, loops, samples); C, s, F₁ : (draws,); stiff : the guess, N/mm; force : of the trial motion (draws,
    loops, samples). step, left : the last step and the residual before it. slopes, moves (draws, loops, kept, samples),
    products (draws, loops, kept, kept) : changes of residuals and of motions in the last passes, and the first's
    products with each other. passed : passes before this one. held, size (draws, loops) : force and RMS residual in mm
    of the best motion. trial becomes the next motion to try.
    """
    apart_and_wide()
    samples, kept = force.shape[2], slopes.shape[2]
    known, last = min(passed, kept), (passed - 1) % kept
    root, weight = np.empty((kept, kept)), np.empty(kept)
    for d in range(force.shape[0]):
        m = d % u.shape[0]
        c, s, f1 = compliance[d], softer[d], first_N[d]
        for j in range(force.shape[1]):
            total = 0.0
            for i in range(samples):
                f = force[d, j, i]
                extra = s * f1 * (1.0 - _exp(-abs(f) / f1))
                r = u[m, j, i] - c * (f + (extra if f > 0.0 else -extra)) - trial[d, j, i]
                total += r * r
                if passed > 0:
                    slopes[d, j, last, i], moves[d, j, last, i] = r - left[d, j, i], step[d, j, i]
                left[d, j, i] = r
            rms = math.sqrt(total / samples)
            if not rms >= size[d, j]:  # better, or no number at all
                size[d, j] = rms
                for i in range(samples):
                    held[d, j, i] = force[d, j, i]
            for k in range(known):
                product, projected = 0.0, 0.0
                for i in range(samples):
                    product += slopes[d, j, last, i] * slopes[d, j, k, i]
                    projected += left[d, j, i] * slopes[d, j, k, i]
                products[d, j, last, k] = products[d, j, k, last] = product
                weight[k] = projected
            _least_squares(products[d, j], weight, root, known)
            for i in range(samples):
                r, move = left[d, j, i], 0.0
                for k in range(known):
                    r -= weight[k] * slopes[d, j, k, i]
                    move -= weight[k] * moves[d, j, k, i]
                open_ = 1.0 + s * _exp(-abs(force[d, j, i]) / f1)
                step[d, j, i] = move + r / (1.0 + c * open_ * stiff)
                trial[d, j, i] += step[d, j, i]


@_jit
def _least_squares(products, weight, root, n):
    """Weights of n vectors that best make another, into weight, which holds its products with them; products (n, n) :
    theirs with each other. By Cholesky's decomposition; a vector of no length gets 0. root : for work."""
    for a in range(n):
        for b in range(a):
            total = products[a, b]
            for k in range(b):
                total -= root[a, k] * root[b, k]
            root[a, b] = total / root[b, b] if root[b, b] > 0.0 else 0.0
        total = (1.0 + _DAMPED) * products[a, a]
        for k in range(a):
            total -= root[a, k] * root[a, k]
        root[a, a] = math.sqrt(max(total, _DAMPED * products[a, a]))
    for a in range(n):
        total = weight[a]
        for k in range(a):
            total -= root[a, k] * weight[k]
        weight[a] = total / root[a, a] if root[a, a] > 0.0 else 0.0
    for a in range(n - 1, -1, -1):
        total = weight[a]
        for k in range(a + 1, n):
            total -= root[k, a] * weight[k]
        weight[a] = total / root[a, a] if root[a, a] > 0.0 else 0.0


@_jit
def speeds_of_change(new, old, velocity, acceleration, half_hz, out_velocity, out_acceleration):
    """Velocity and acceleration (SI), those of the change new − old, mm, of periodic loops added, by central
    differences; half_hz (loops,) half the sampling rate; new, out_… : (draws, loops, samples), others 1 or draws."""
    apart_and_wide()
    samples = new.shape[2]
    change = np.empty(samples + 2)
    for d in range(new.shape[0]):
        m = d % old.shape[0]
        for j in range(new.shape[1]):
            for i in range(samples):
                change[i + 1] = new[d, j, i] - old[m, j, i]
            change[0], change[samples + 1] = change[samples], change[1]
            once, twice = 1e-3 * half_hz[j], 4e-3 * half_hz[j] ** 2
            for i in range(samples):
                out_velocity[d, j, i] = velocity[m, j, i] + once * (change[i + 2] - change[i])
                curvature = change[i + 2] - 2.0 * change[i + 1] + change[i]
                out_acceleration[d, j, i] = acceleration[m, j, i] + twice * curvature
