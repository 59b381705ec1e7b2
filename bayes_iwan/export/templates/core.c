@HEAD@
#include <math.h>
#include <stddef.h>
#include <string.h>

/* ---- include this file in one of yours; what it offers stands at its end under "steps" ----------------------------*/

#define ISOLATOR_SETS @SETS@ /* parameter sets: 0 the point estimate, the others draws of the posterior */
#define ISOLATOR_PIECES @PIECES@ /* pieces of the sliders' memory; more than @PIECES@ are merged where it matters least */

typedef struct {
@PARAMETER_FIELDS@
    double phi_top_N;    /* above this slip force there are no elements */
    double mean_slip_N;  /* mean slip force: the table's end */
    const double *table; /* cubics of L(phi) = E[min(Phi, phi)], N, four numbers a cell */
} isolator_parameters;

typedef struct { /* doubles only, no pointers: copy it to save it, copy it back to restore it */
    double time_s, u_mm, v_m_s, a_m_s2, force_N; /* where the last step ended */
    double slid_mm, edge_N, front_mm_N;          /* sliders: their displacement, and the piece that slips now */
@STATE_FIELDS@
    double pieces;                               /* how many there are of: */
    double piece[ISOLATOR_PIECES][6];            /* x = p + m phi up to end; x(end), L(end), sum beyond end */
} isolator_state;

typedef struct { /* for solvers that repeat or reject steps; doubles only as well */
    isolator_state accepted, trial;
} isolator_track;

/* ---- parameters --------------------------------------------------------------------------------------------------*/

@TABLES@
const isolator_parameters isolator_sets[ISOLATOR_SETS] = {
@VALUES@
};

/* ---- sliders: the force of infinitely many stop elements by a stack of straight pieces ---------------------------*/

#define OCTAVES @OCTAVES@
#define CELLS @CELLS@ /* in each octave */
enum { P, M, END, X_END, L_END, REST };

static double limited_mean(const isolator_parameters *p, double phi)
{
    const double x = phi / p->phi_top_N;
    const double *c = p->table;
    double place;
    int exponent, octave, cell;
    if (!(x < 1.0)) {
        return x >= 1.0 ? p->mean_slip_N : x;
    }
    place = frexp(x, &exponent);
    octave = exponent - 1 + OCTAVES;
    if (!(x > 0.0) || octave < 0) {
        place = x * ldexp(1.0, OCTAVES);
    } else {
        place = (2.0 * place - 1.0) * CELLS;
        cell = (int)place;
        place -= cell;
        c += 4 * (octave * CELLS + cell + 1);
    }
    return c[0] + place * (c[1] + place * (c[2] + place * c[3]));
}

static int drop_least(int top, double (*st)[6])
{
    int least = 2, j;
    double smallest = HUGE_VAL, start, start_x, width, slope;
    for (j = 2; j < top - 1; j++) {
        const double a = st[j][L_END] - st[j + 1][L_END], b = st[j - 1][L_END] - st[j + 1][L_END];
        const double area =
            fabs(a * (st[j - 1][X_END] - st[j + 1][X_END]) - b * (st[j][X_END] - st[j + 1][X_END]));
        if (area < smallest) {
            least = j;
            smallest = area;
        }
    }
    start = st[least + 1][END];
    start_x = st[least + 1][X_END];
    width = st[least - 1][END] - start;
    slope = width > 0.0 ? (st[least - 1][X_END] - start_x) / width : 0.0;
    st[least - 1][P] = start_x - slope * start;
    st[least - 1][M] = slope;
    for (j = least; j < top - 1; j++) {
        memcpy(st[j], st[j + 1], sizeof st[j]);
        st[j][REST] = st[j - 1][REST] - st[j - 1][M] * (st[j - 1][L_END] - st[j][L_END]);
    }
    return top - 1;
}

static int push(int top, double p, double m, double end, double x_end, double ell, double (*st)[6])
{
    if (top > 1 && end > st[top - 1][END] * (1.0 - 1e-10)) {
        top--; /* a vertex at the last one's place takes it: equal cycles would else fill the memory by rounding */
    }
    if (top == ISOLATOR_PIECES) {
        top = drop_least(top, st);
    }
    st[top][P] = p;
    st[top][M] = m;
    st[top][END] = end;
    st[top][X_END] = x_end;
    st[top][L_END] = ell;
    st[top][REST] = st[top - 1][REST] - st[top - 1][M] * (st[top - 1][L_END] - ell);
    return top + 1;
}

/* More than the front slips: cut the whole polyline with the cone of what each element can carry. */
static int cut(const isolator_parameters *p, int top, double u, double up, double down, double *front, double *front_x,
               double (*st)[6])
{
    double work[3 * ISOLATOR_PIECES + 2][2];
    double last_phi = 0.0, last_e = 0.0;
    int count = 0, last_side = 0, j, turn;
    for (j = top; j > 0; j--) {
        const double phi = j == top ? *front : st[j][END], x = j == top ? *front_x : st[j][X_END], e = u - x;
        const int side = e > up * phi ? 1 : (e < -down * phi ? -1 : 0);
        for (turn = 0; turn < 2; turn++) {
            const int s = turn == 0 ? last_side : side;
            const double r = s > 0 ? up : down;
            if (s != 0 && last_side != side) {
                const double a = s * last_e - r * last_phi, b = s * e - r * phi;
                const double at = last_phi + (phi - last_phi) * (a / (a - b));
                work[count][0] = at;
                work[count++][1] = u - s * r * at;
            }
        }
        if (side == 0) {
            work[count][0] = phi;
            work[count++][1] = x;
        }
        last_side = side;
        last_phi = phi;
        last_e = e;
    }
    if (last_side != 0) {
        work[count][0] = last_side * last_e / (last_side > 0 ? up : down);
        work[count++][1] = u - last_e;
    }
    st[0][P] = st[0][X_END] = work[count - 1][1];
    top = 1;
    for (j = count - 1; j > 0; j--) {
        const double width = work[j][0] - work[j - 1][0];
        const double slope = width > 0.0 ? (work[j][1] - work[j - 1][1]) / width : 0.0;
        top = push(top, work[j][1] - slope * work[j][0], slope, work[j][0], work[j][1], limited_mean(p, work[j][0]), st);
    }
    *front = work[0][0];
    *front_x = work[0][1];
    return top;
}

/* Move all sliders to u (mm); alpha: what they carry over what they carry at rest; k their stiffness, N/mm. */
static double slide(const isolator_parameters *p, isolator_state *t, double u, double alpha, double k, double asymmetry)
{
    double(*st)[6] = t->piece;
    const double up = alpha / k * (1.0 + asymmetry), down = alpha / k * (1.0 - asymmetry), du = u - t->slid_mm;
    double q = t->front_mm_N, edge = t->edge_N;
    int top = (int)t->pieces, beyond, j;
    if (du > 0.0 || du < 0.0) {
        const double s = du > 0.0 ? 1.0 : -1.0, r = du > 0.0 ? up : down;
        double m;
        if (s * (du + q * edge) <= r * edge) {
            if (edge > 0.0) {
                top = push(top, t->slid_mm, -q, edge, t->slid_mm - q * edge, limited_mean(p, edge), st);
            }
        } else {
            while (top > 1 && s * (u - st[top - 1][X_END]) > r * st[top - 1][END]) {
                top--;
            }
        }
        m = st[top - 1][M];
        edge = r + s * m > 1e-9 * r ? s * (u - st[top - 1][P]) / (r + s * m) : st[top - 1][END];
        q = s * r;
    }
    beyond = !(du > 0.0 || du < 0.0) && (q > up || -q > down);
    for (j = 1; j < top; j++) {
        const double e = u - st[j][X_END], most = st[j][END] * (1.0 + 1e-12);
        beyond |= e > up * most || -e > down * most;
    }
    if (beyond) {
        double x = u - q * edge;
        top = cut(p, top, u, up, down, &edge, &x, st);
        q = edge > 0.0 ? (u - x) / edge : 0.0;
    }
    t->slid_mm = u;
    t->edge_N = edge;
    t->front_mm_N = q;
    t->pieces = top;
    return k * ((q + st[top - 1][M]) * limited_mean(p, edge) + st[top - 1][REST] - st[top - 1][M] * st[top - 1][L_END]);
}

/* ---- laws --------------------------------------------------------------------------------------------------------*/

static double specimen(const isolator_parameters *p, isolator_state *s, double h, double u, double v);

@HELPERS@
/* The specimen moved by u (mm), v (m/s): normal force, stiffness, sliders, parallel spring. h: seconds since before. */
static double specimen(const isolator_parameters *p, isolator_state *s, double h, double u, double v)
{
    const double A = p->amplitude_mm;
    double alpha = 1.0, k = p->k1_N_mm, slip;
    (void)h;
    (void)v;
    (void)A;
@ALPHA@
@STIFFNESS@
    slip = alpha;
@SLIP@
    k = k > 1e-12 ? k : 1e-12;
    return slide(p, s, u, slip, k, @ASYMMETRY@) + p->kp_N_mm * u;
}

static double device(const isolator_parameters *p, isolator_state *s, double h, double u, double v, double a)
{
    double force;
    (void)a;
@BEFORE@
@SPECIMEN@
@FORCE@
    s->time_s += h;
    s->u_mm = u;
    s->v_m_s = v;
    s->a_m_s2 = a;
    s->force_N = force;
    return force;
}

#define MOST 1e9 /* m, m/s, m/s2: a solver that has gone astray */

/* ---- steps -------------------------------------------------------------------------------------------------------*/

/* At rest at u = 0, all contacts unstressed, at time_s. */
void isolator_start(const isolator_parameters *p, isolator_state *s, double time_s)
{
    memset(s, 0, sizeof *s);
    s->time_s = time_s;
    s->pieces = 1.0;
    s->piece[0][END] = HUGE_VAL;
    s->piece[0][L_END] = p->mean_slip_N;
@START@
}

/* Displacement (mm) and velocity (m/s) at the share x of a step: the cubic through both ends. */
static void between(double x, double h, double u0, double v0, double u1, double v1, double *u, double *v)
{
    const double d = u1 - u0, b0 = 1e3 * v0 * h, b1 = 1e3 * v1 * h, c2 = 3.0 * d - 2.0 * b0 - b1, c3 = b0 + b1 - 2.0 * d;
    *u = u0 + x * (b0 + x * (c2 + x * c3));
    *v = 1e-3 * (b0 + x * (2.0 * c2 + x * 3.0 * c3)) / h;
}

/* The share of a step after which its velocity, of opposite signs at both ends, is zero. */
static double turning(double h, double u0, double v0, double u1, double v1)
{
    const double d = u1 - u0, b0 = 1e3 * v0 * h, b1 = 1e3 * v1 * h;
    const double a = 3.0 * (b0 + b1 - 2.0 * d), b = 2.0 * (3.0 * d - 2.0 * b0 - b1);
    const double root = sqrt(fmax(b * b - 4.0 * a * b0, 0.0)), w = -0.5 * (b + (b > 0.0 ? root : -root));
    const double one = a > 0.0 || a < 0.0 ? w / a : -1.0, two = w > 0.0 || w < 0.0 ? b0 / w : -1.0;
    if (one > 0.0 && one < 1.0) {
        return one;
    }
    return two > 0.0 && two < 1.0 ? two : 0.5;
}

/* One step of h_s seconds (0 is allowed) to stretch u_m, velocity v_m_s and acceleration a_m_s2 at its end. Returns 1
   and the force in N; 0 where h_s is negative or a number not finite, or 1e9 and more: nothing has changed then and
   *force_N is the last force. The path between is the cubic through both ends, so a reversal inside is not missed. */
int isolator_step(const isolator_parameters *p, isolator_state *s, double h_s, double u_m, double v_m_s, double a_m_s2,
                  double *force_N)
{
    const double u0 = s->u_mm, v0 = s->v_m_s, a0 = s->a_m_s2, u1 = 1e3 * u_m, v1 = v_m_s;
    double from = 0.0, turn = 2.0, u, v;
    int i, n = @SUBSTEPS@;
    *force_N = s->force_N;
    if (!(fabs(u_m) < MOST && fabs(v_m_s) < MOST && fabs(a_m_s2) < MOST && h_s >= 0.0 && isfinite(h_s))) {
        return 0;
    }
    if (h_s > 0.0 && ((v0 > 0.0 && v1 < 0.0) || (v0 < 0.0 && v1 > 0.0))) {
        turn = turning(h_s, u0, v0, u1, v1);
    }
    for (i = 1; h_s > 0.0 && i <= n; i++) {
        const double to = i < n ? (double)i / n : 1.0;
        if (turn > from && turn < to) {
            between(turn, h_s, u0, v0, u1, v1, &u, &v);
            device(p, s, (turn - from) * h_s, u, 0.0, a0 + turn * (a_m_s2 - a0));
            from = turn;
        }
        if (i < n) {
            between(to, h_s, u0, v0, u1, v1, &u, &v);
            device(p, s, (to - from) * h_s, u, v, a0 + to * (a_m_s2 - a0));
            from = to;
        }
    }
    *force_N = device(p, s, (1.0 - from) * h_s, u1, v1, a_m_s2);
    return 1;
}

static void copy_state(isolator_state *to, const isolator_state *from)
{
    memcpy(to, from, offsetof(isolator_state, piece) + (size_t)from->pieces * sizeof from->piece[0]);
}

void isolator_track_start(const isolator_parameters *p, isolator_track *t, double time_s)
{
    isolator_start(p, &t->accepted, time_s);
    t->trial = t->accepted;
}

/* The force at a time, however often a solver asks: a later time accepts what was asked last, the same or an earlier
   one replaces it. Returns 0 for a time before the accepted one (restore a saved track then), or as isolator_step. */
int isolator_at(const isolator_parameters *p, isolator_track *t, double time_s, double u_m, double v_m_s, double a_m_s2,
                double *force_N)
{
    *force_N = t->trial.force_N;
    if (!isfinite(time_s) || time_s < t->accepted.time_s) {
        return 0;
    }
    if (time_s > t->trial.time_s) {
        copy_state(&t->accepted, &t->trial);
    } else {
        copy_state(&t->trial, &t->accepted);
    }
    if (!isolator_step(p, &t->trial, time_s - t->accepted.time_s, u_m, v_m_s, a_m_s2, force_N)) {
        return 0;
    }
    t->trial.time_s = time_s;
    return 1;
}

/* For callers from other languages: a state's size in doubles (a track has two), parameter sets, and functions that
   take A of Eq. (11) in m (NaN: the set's own). */
int isolator_state_size(void)
{
    return (int)(sizeof(isolator_state) / sizeof(double));
}

const isolator_parameters *isolator_set(int i)
{
    return &isolator_sets[i < 0 || i >= ISOLATOR_SETS ? 0 : i];
}

static isolator_parameters with_amplitude(int set, double amplitude_m)
{
    isolator_parameters p = *isolator_set(set);
    if (amplitude_m > 0.0 && isfinite(amplitude_m)) {
        p.amplitude_mm = 1e3 * amplitude_m;
    }
    return p;
}

int isolator_track_at(int set, double amplitude_m, double *track, double time_s, double u_m, double v_m_s,
                      double a_m_s2, double *force_N)
{
    const isolator_parameters p = with_amplitude(set, amplitude_m);
    return isolator_at(&p, (isolator_track *)(void *)track, time_s, u_m, v_m_s, a_m_s2, force_N);
}

/* n steps in one call, from arrays; returns how many were done. */
int isolator_run(int set, double amplitude_m, double *state, int n, double h_s, const double *u_m, const double *v_m_s,
                 const double *a_m_s2, double *force_N)
{
    const isolator_parameters p = with_amplitude(set, amplitude_m);
    int i;
    for (i = 0; i < n; i++) {
        if (!isolator_step(&p, (isolator_state *)(void *)state, h_s, u_m[i], v_m_s[i], a_m_s2[i], &force_N[i])) {
            break;
        }
    }
    return i;
}
