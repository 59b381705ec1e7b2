/* The identified device as a MuJoCo plugin: a passive force on a slide or hinge joint.

   Build (the headers and the library come with `pip install mujoco`; M is its folder):
       cc -std=c99 -O2 -shared -fPIC -I$M/include -o libisolator_plugin.so isolator_plugin.c $M/libmujoco.so.* -lm
   Load with mj_loadPluginLibrary, and in the model:
       <extension><plugin plugin="@NAME@"><instance name="device">
         <config key="joint" value="isolator"/><config key="draw" value="0"/><config key="amplitude" value="0.001"/>
       </instance></plugin></extension>
       ... <body><plugin instance="device"/> ...
   Its memory is part of mjData's plugin state, so it is copied, saved and restored with it. */
#include "isolator.c"
#include <mujoco/mujoco.h>
#include <stdlib.h>

static const char *const attributes[] = {"joint", "draw", "amplitude"};

static int joint_of(const mjModel *m, int instance)
{
    const char *name = mj_getPluginConfig(m, instance, "joint");
    const int id = name == NULL ? -1 : mj_name2id(m, mjOBJ_JOINT, name);
    return id >= 0 && (m->jnt_type[id] == mjJNT_SLIDE || m->jnt_type[id] == mjJNT_HINGE) ? id : -1;
}

static isolator_parameters parameters_of(const mjModel *m, int instance)
{
    const char *draw = mj_getPluginConfig(m, instance, "draw"), *a = mj_getPluginConfig(m, instance, "amplitude");
    return with_amplitude(draw == NULL ? 0 : atoi(draw), a == NULL ? 0.0 : atof(a));
}

static int state_size(const mjModel *m, int instance)
{
    (void)m, (void)instance;
    return (int)(sizeof(isolator_track) / sizeof(mjtNum));
}

static void reset(const mjModel *m, mjtNum *state, void *data, int instance)
{
    const isolator_parameters p = parameters_of(m, instance);
    (void)data;
    isolator_track_start(&p, (isolator_track *)(void *)state, 0.0);
}

static int init(const mjModel *m, mjData *d, int instance)
{
    (void)d;
    if (joint_of(m, instance) < 0) {
        mju_warning("@NAME@: config joint must name a slide or a hinge joint of the model");
        return -1;
    }
    return 0;
}

static void compute(const mjModel *m, mjData *d, int instance, int capability)
{
    const isolator_parameters p = parameters_of(m, instance);
    const int id = joint_of(m, instance), at = m->jnt_qposadr[id], dof = m->jnt_dofadr[id];
    const double u = d->qpos[at] - m->qpos0[at], v = d->qvel[dof], a = d->qacc[dof];
    isolator_track *track = (isolator_track *)(void *)(d->plugin_state + m->plugin_stateadr[instance]);
    double force = 0.0;
    (void)capability;
    if (d->time < track->accepted.time_s) {
        isolator_track_start(&p, track, d->time);
    }
    isolator_at(&p, track, d->time, u, v, a, &force);
    d->qfrc_passive[dof] -= force;
}

mjPLUGIN_LIB_INIT(isolator)
{
    mjpPlugin plugin;
    mjp_defaultPlugin(&plugin);
    plugin.name = "@NAME@";
    plugin.capabilityflags = mjPLUGIN_PASSIVE;
    plugin.nattribute = 3;
    plugin.attributes = attributes;
    plugin.nstate = state_size;
    plugin.init = init;
    plugin.reset = reset;
    plugin.compute = compute;
    mjp_registerPlugin(&plugin);
}
