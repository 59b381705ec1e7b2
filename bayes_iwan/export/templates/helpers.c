/* Functions that laws call; each is written into the file if its name occurs there. One paragraph each. */

static double power_of(double x, double exponent)
{
    return fabs(x) > 0.0 ? pow(fabs(x), exponent) : 0.0;
}

static double falling(double x, double q) /* (1 + q x)^(-1/q), e^-x at q = 0 */
{
    const double grown = 1.0 + q * x;
    return fabs(q) < 1e-7 ? exp(-x) : (grown > 0.0 ? exp(-log(grown) / q) : 0.0);
}

static double growing(double x, double q) /* ((1 + x)^q - 1)/q, ln(1 + x) at q = 0 */
{
    return fabs(q) < 1e-7 ? log1p(x) : expm1(q * log1p(x)) / q;
}

/* x of tau dx/dt = y - x after h seconds in which y runs straight from y0 to y1 */
static double relaxed(double y1, double y0, double x0, double h, double tau)
{
    const double n = h / (tau > 1e-15 ? tau : 1e-15), stay = exp(-n), lead = n > 1e-12 ? -expm1(-n) / n : 1.0;
    return y1 - (y1 - y0) * lead + (x0 - y0) * stay;
}

static double softplus(double x)
{
    return x > 0.0 ? x + log1p(exp(-x)) : log1p(exp(x));
}

static double beyond(double x, double knee, double width) /* two slopes, its slope at 0 taken off */
{
    return width * (softplus((x - knee) / width) - softplus(-knee / width)) - x / (1.0 + exp(knee / width));
}

static double contact(double into, double speed, double scale, double exponent, double loss)
{
    return into > 0.0 ? scale * power_of(into / scale, exponent) * fmax(1.0 + loss * speed, 0.0) : 0.0;
}

/* y of y'' / w^2 + 2 z y' / w + y = x after h seconds in which x runs straight from x0 to x1 */
static void resonance(double w, double z, double h, double x0, double x1, double *y, double *speed)
{
    const double slope = h > 0.0 ? (x1 - x0) / h : 0.0, late = 2.0 * z * slope / w;
    const double wd = w * sqrt(fmax(1.0 - z * z, 0.0)), c = cos(wd * h), s = wd > 1e-9 * w ? sin(wd * h) / wd : h;
    const double y0 = *y - (x0 - late), v0 = *speed - slope, stay = exp(-z * w * h);
    if (h > 0.0) {
        *y = x1 - late + stay * (y0 * c + (v0 + z * w * y0) * s);
        *speed = slope + stay * (v0 * c - (w * w * y0 + z * w * v0) * s);
    }
}

/* 1 where half a cycle has ended: u has gone back from a far point by a stroke that counts. The first begins where the
   motion does, after whatever rest; a jump in no time is none. */
static int half_cycle(const isolator_parameters *p, isolator_state *s, double now, double u)
{
    const double least = @LEAST_STROKE@ * p->length_mm;
    if (!(s->cycle_way > 0.0 || s->cycle_way < 0.0)) {
        if (!(now > s->time_s)) {
            s->cycle_turn_mm = u;
        }
        s->cycle_turn_s = s->time_s;
        s->cycle_way = fabs(u - s->cycle_turn_mm) < least ? 0.0 : (u > s->cycle_turn_mm ? 1.0 : -1.0);
        s->cycle_far_mm = u;
        s->cycle_far_s = now;
        return 0;
    }
    if ((u - s->cycle_far_mm) * s->cycle_way > 0.0) {
        s->cycle_far_mm = u;
        s->cycle_far_s = now;
        return 0;
    }
    if (fabs(u - s->cycle_far_mm) < least) {
        return 0;
    }
    s->cycle_amplitude_mm = 0.5 * fabs(s->cycle_far_mm - s->cycle_turn_mm);
    s->cycle_hz = 0.5 / fmax(s->cycle_far_s - s->cycle_turn_s, 1e-12);
    s->cycle_turn_mm = s->cycle_far_mm;
    s->cycle_turn_s = s->cycle_far_s;
    s->cycle_far_mm = u;
    s->cycle_far_s = now;
    s->cycle_way = -s->cycle_way;
    return 1;
}

static double sigmoid(double x)
{
    return 1.0 / (1.0 + exp(-x));
}

/* The specimen's force behind a play of half a width on each side of where that force crosses zero on this branch.
   Its ends close gradually over `width`. The crossing is found ahead of the motion, by moving the specimen on a trial. */
static double through_play(const isolator_parameters *p, isolator_state *s, double h, double u, double v, double half,
                           double width)
{
    const double still = v * 2.0 * sigmoid(-half / width);
    double ahead, behind, way = v > 0.0 ? 1.0 : (v < 0.0 ? -1.0 : 0.0);
    if (way * s->free_play_N < 0.0) {
        const isolator_state before = *s;
        double low = s->free_play_at_mm, high = u + way * (half + 40.0 * width);
        int i;
        if (way * (high - low) > 0.0 && way * specimen(p, s, h, high, v) > 0.0) {
            for (i = 0; i < 52; i++) {
                const double at = 0.5 * (low + high);
                *s = before;
                *(way * specimen(p, s, h, at, still) < 0.0 ? &low : &high) = at;
            }
        }
        *s = before;
        s->free_play_mid_mm = high;
    }
    ahead = (u - s->free_play_mid_mm - half) / width;
    behind = (s->free_play_mid_mm - u - half) / width;
    s->free_play_at_mm = s->free_play_mid_mm + width * (softplus(ahead) - softplus(behind));
    s->free_play_N = specimen(p, s, h, s->free_play_at_mm, v * (sigmoid(ahead) + sigmoid(behind)));
    return s->free_play_N;
}
