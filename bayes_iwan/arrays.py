"""The two array types that every folder speaks of."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

#: real numbers in double precision, of any shape
Array = NDArray[np.float64]
#: values by name, (draws,) each
ParameterValues = Mapping[str, Array]
