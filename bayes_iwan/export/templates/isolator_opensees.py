"""The identified device as a uniaxial material of OpenSees: elastic-perfectly-plastic springs in parallel.

    import openseespy.opensees as ops, isolator_opensees
    isolator_opensees.add(ops, tag=1)              # a material whose strain is the stretch in m and whose stress is in N

Use it in a zeroLength element, or a truss of length and area 1. Tags first_tag, first_tag + 1, ... are used for the
springs inside. Needs `pip install openseespy` (on Debian also libblas3 and liblapack3).

@CARD@
"""

#: of each set (0 the point estimate, then draws): stiffness (N/m) and the stretches (m) at which a spring yields when
#: pulled and pushed; and the stiffness (N/m) of the spring beside them
SETS = [
@VALUES@
]


def add(ops, tag, draw=0, first_tag=None):
    """Define the material `tag`; returns the tags used inside."""
    if not 0 <= draw < len(SETS):
        raise ValueError(f"draw must be 0 (the point estimate) to {len(SETS) - 1}, not {draw}")
    spring, elements = SETS[draw]
    first = tag * 10000 + 1 if first_tag is None else first_tag
    inside = list(range(first, first + len(elements) + 1))
    ops.uniaxialMaterial("Elastic", inside[0], spring)
    for one, (stiffness, pulled, pushed) in zip(inside[1:], elements):
        ops.uniaxialMaterial("ElasticPP", one, stiffness, pulled, -pushed)
    ops.uniaxialMaterial("Parallel", tag, *inside)
    return inside
