"""Identify the generalized Iwan model of a friction vibration isolator from measured loops, with what is known of it.

In a notebook (each command line's answer is an object here):

    import bayes_iwan as bi
    posterior = bi.identify("data/rope_spring", out="results", seed=1)
    posterior                                               # values, intervals and gap on one screen
    posterior.predict(frequency_hz=12.0, amplitude_mm=0.5)  # loops with bands
    bi.diagnose("data/rope_spring", quick=True)             # what the model misses, and why
    bi.plot.loops(posterior, width="column")                # figures; bi.demo() gives data to try all this on
"""

import importlib

import lazy_loader

from bayes_iwan.errors import nearest

__version__ = "0.1.0"

#: each public name is imported when it is first asked for, from where __init__.pyi says
_named, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}" + nearest(name, __all__))
    if name in ("plot", "Posterior", "Problem", "Diagnosis") or name.endswith(("_loops", "_problem")):
        importlib.import_module("bayes_iwan.api")  # gives results their plots and exports
    return importlib.import_module("bayes_iwan.report.plot") if name == "plot" else _named(name)
