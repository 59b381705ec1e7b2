/* FMI 2.0 co-simulation and FMI 3.0 co-simulation of isolator.c: one source and one binary for both. The types are
   FMI's own (fmi-standard.org), declared here so that it compiles without its headers.

   The force is a function of the inputs at the same time: set displacement and velocity, get the force. After a step and
   before new inputs it is what the inputs lead to if the acceleration stays. */
#include "isolator.c"
#include <stdint.h>
#include <stdlib.h>

#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED
#endif

enum { TIME, DISPLACEMENT, VELOCITY, ACCELERATION, FORCE, AMPLITUDE, DRAW };
enum { OK, WARNING, DISCARD, ERROR };

typedef struct {
    isolator_track track;
    double number[DRAW]; /* by value reference */
    int draw, fresh;     /* fresh: inputs were set after the force was computed */
} instance_state;

static isolator_parameters parameters_of(const instance_state *i)
{
    return with_amplitude(i->draw, i->number[AMPLITUDE]);
}

static int begin(instance_state *i, double time_s)
{
    const isolator_parameters p = parameters_of(i);
    isolator_track_start(&p, &i->track, time_s);
    i->number[TIME] = time_s;
    i->fresh = 1;
    return OK;
}

static int reset(instance_state *i)
{
    memset(i, 0, sizeof *i);
    i->number[AMPLITUDE] = 1e-3 * isolator_sets[0].amplitude_mm;
    return begin(i, 0.0);
}

static int evaluate(instance_state *i)
{
    const isolator_parameters p = parameters_of(i);
    const double *x = i->number;
    if (!isolator_at(&p, &i->track, x[TIME], x[DISPLACEMENT], x[VELOCITY], x[ACCELERATION], &i->number[FORCE])) {
        return DISCARD;
    }
    i->fresh = 0;
    return OK;
}

static int do_step(instance_state *i, double time_s, double h_s)
{
    const isolator_parameters p = parameters_of(i);
    const double *x = i->number, a = x[ACCELERATION], v = x[VELOCITY] + a * h_s;
    if (!isfinite(h_s) || h_s < 0.0 || fabs(time_s - x[TIME]) > 1e-9 * (1.0 + fabs(time_s)) || evaluate(i) != OK) {
        return DISCARD;
    }
    i->number[TIME] = time_s + h_s;
    return isolator_at(&p, &i->track, time_s + h_s, x[DISPLACEMENT] + h_s * (x[VELOCITY] + 0.5 * a * h_s), v, a,
                       &i->number[FORCE]) ? OK : DISCARD;
}

static int get_number(instance_state *i, unsigned reference, double *value)
{
    if (reference > AMPLITUDE || (reference == FORCE && i->fresh && evaluate(i) != OK)) {
        return ERROR;
    }
    *value = i->number[reference];
    return OK;
}

static int set_number(instance_state *i, unsigned reference, double value)
{
    if (reference < DISPLACEMENT || reference > AMPLITUDE || reference == FORCE || !isfinite(value)
        || (reference == AMPLITUDE && !(value > 0.0))) {
        return ERROR;
    }
    i->number[reference] = value;
    i->fresh = 1;
    return OK;
}

static int get_draw(instance_state *i, unsigned reference, int *value)
{
    *value = i->draw;
    return reference == DRAW ? OK : ERROR;
}

static int set_draw(instance_state *i, unsigned reference, int draw)
{
    if (reference != DRAW || draw < 0 || draw >= ISOLATOR_SETS) {
        return ERROR;
    }
    i->draw = draw;
    return begin(i, i->number[TIME]);
}

static instance_state *made(int wanted)
{
    instance_state *i = wanted ? malloc(sizeof *i) : NULL;
    if (i != NULL) {
        reset(i);
    }
    return i;
}

/* A saved state is a whole instance. */
static int save(const void *i, void **state)
{
    if (*state == NULL && (*state = malloc(sizeof(instance_state))) == NULL) {
        return ERROR;
    }
    memcpy(*state, i, sizeof(instance_state));
    return OK;
}

#define EACH(call) size_t k; int status = OK; for (k = 0; k < n && status == OK; k++) status = call; return status;
/* Functions of the standards for what this model does not have: they take their first argument only, and say no. */
#define NOT_HERE(name) EXPORTED int name(void *c) { (void)c; return ERROR; }
#define ALWAYS_FINE(name) EXPORTED int name(void *c) { (void)c; return OK; }

/* ---- FMI 2.0 -----------------------------------------------------------------------------------------------------*/

EXPORTED const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORTED const char *fmi2GetVersion(void) { return "2.0"; }
ALWAYS_FINE(fmi2SetDebugLogging)
ALWAYS_FINE(fmi2EnterInitializationMode)
ALWAYS_FINE(fmi2ExitInitializationMode)
ALWAYS_FINE(fmi2Terminate)

EXPORTED void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const void *functions,
                      int visible, int logging)
{
    (void)name, (void)resources, (void)functions, (void)visible, (void)logging;
    return made(type == 1 && guid != NULL && strcmp(guid, "@GUID@") == 0);
}

EXPORTED void fmi2FreeInstance(void *c) { free(c); }
EXPORTED int fmi2Reset(void *c) { return reset(c); }

EXPORTED int fmi2SetupExperiment(void *c, int with_tolerance, double tolerance, double start, int with_stop, double stop)
{
    (void)with_tolerance, (void)tolerance, (void)with_stop, (void)stop;
    return begin(c, start);
}

EXPORTED int fmi2GetReal(void *c, const unsigned *reference, size_t n, double *value)
{
    EACH(get_number(c, reference[k], &value[k]))
}

EXPORTED int fmi2SetReal(void *c, const unsigned *reference, size_t n, const double *value)
{
    EACH(set_number(c, reference[k], value[k]))
}

EXPORTED int fmi2GetInteger(void *c, const unsigned *reference, size_t n, int *value)
{
    EACH(get_draw(c, reference[k], &value[k]))
}

EXPORTED int fmi2SetInteger(void *c, const unsigned *reference, size_t n, const int *value)
{
    EACH(set_draw(c, reference[k], value[k]))
}

EXPORTED int fmi2GetFMUstate(void *c, void **state) { return save(c, state); }
EXPORTED int fmi2SetFMUstate(void *c, void *state) { return save(state, &c); }

EXPORTED int fmi2FreeFMUstate(void *c, void **state)
{
    (void)c;
    free(state == NULL ? NULL : *state);
    return state == NULL ? OK : (*state = NULL, OK);
}

EXPORTED int fmi2SerializedFMUstateSize(void *c, void *state, size_t *size)
{
    (void)c, (void)state;
    *size = sizeof(instance_state);
    return OK;
}

EXPORTED int fmi2SerializeFMUstate(void *c, void *state, char *bytes, size_t size)
{
    (void)c;
    return size < sizeof(instance_state) ? ERROR : (memcpy(bytes, state, sizeof(instance_state)), OK);
}

EXPORTED int fmi2DeSerializeFMUstate(void *c, const char *bytes, size_t size, void **state)
{
    (void)c;
    return size == sizeof(instance_state) ? save(bytes, state) : ERROR;
}

EXPORTED int fmi2DoStep(void *c, double time_s, double h_s, int no_return)
{
    (void)no_return;
    return do_step(c, time_s, h_s);
}

@FMI2_NOT_HERE@

/* ---- FMI 3.0 -----------------------------------------------------------------------------------------------------*/

EXPORTED const char *fmi3GetVersion(void) { return "3.0"; }
ALWAYS_FINE(fmi3SetDebugLogging)
ALWAYS_FINE(fmi3ExitInitializationMode)
ALWAYS_FINE(fmi3Terminate)

EXPORTED void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, _Bool visible, _Bool logging,
                                  _Bool events, _Bool early, const uint32_t *intermediate, size_t n, void *environment,
                                  void *log, void *update)
{
    (void)events, (void)early, (void)intermediate, (void)n, (void)environment, (void)log, (void)update;
    return fmi2Instantiate(name, 1, token, resources, NULL, visible, logging);
}

EXPORTED void *fmi3InstantiateModelExchange(void *name) { (void)name; return NULL; }
EXPORTED void *fmi3InstantiateScheduledExecution(void *name) { (void)name; return NULL; }
EXPORTED void fmi3FreeInstance(void *c) { free(c); }
EXPORTED int fmi3Reset(void *c) { return reset(c); }

EXPORTED int fmi3EnterInitializationMode(void *c, _Bool with_tolerance, double tolerance, double start, _Bool with_stop, double stop)
{
    return fmi2SetupExperiment(c, with_tolerance, tolerance, start, with_stop, stop);
}

#define MANY(name, fmi2name, type) EXPORTED int name(void *c, const uint32_t *r, size_t n, type *value, size_t values) \
    { return values == n ? fmi2name(c, r, n, value) : ERROR; }
MANY(fmi3GetFloat64, fmi2GetReal, double)
MANY(fmi3SetFloat64, fmi2SetReal, const double)
MANY(fmi3GetInt32, fmi2GetInteger, int32_t)
MANY(fmi3SetInt32, fmi2SetInteger, const int32_t)

EXPORTED int fmi3GetFMUState(void *c, void **state) { return fmi2GetFMUstate(c, state); }
EXPORTED int fmi3SetFMUState(void *c, void *state) { return fmi2SetFMUstate(c, state); }
EXPORTED int fmi3FreeFMUState(void *c, void **state) { return fmi2FreeFMUstate(c, state); }
EXPORTED int fmi3SerializedFMUStateSize(void *c, void *state, size_t *size) { return fmi2SerializedFMUstateSize(c, state, size); }
EXPORTED int fmi3SerializeFMUState(void *c, void *s, char *x, size_t n) { return fmi2SerializeFMUstate(c, s, x, n); }
EXPORTED int fmi3DeserializeFMUState(void *c, const char *x, size_t n, void **s) { return fmi2DeSerializeFMUstate(c, x, n, s); }

EXPORTED int fmi3DoStep(void *c, double time_s, double h_s, _Bool no_return, _Bool *event, _Bool *end, _Bool *early, double *last)
{
    const int status = do_step(c, time_s, h_s);
    (void)no_return;
    *event = *end = *early = 0;
    *last = status == OK ? time_s + h_s : time_s;
    return status;
}

@FMI3_NOT_HERE@
