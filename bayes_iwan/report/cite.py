"""How to cite the package and what it is built on."""

from html import escape

from bayes_iwan import __version__
from bayes_iwan.screen import wrapped

SOFTWARE = f"bayes-iwan {__version__}"

_BIBTEX = f"""@software{{bayes_iwan,
  title   = {{bayes-iwan: Bayesian identification of the generalized Iwan model and diagnosis of the sim-to-real gap}},
  version = {{{__version__}}},
  license = {{MIT}}
}}
@article{{foremanmackey2013,
  author  = {{Foreman-Mackey, Daniel and Hogg, David W. and Lang, Dustin and Goodman, Jonathan}},
  title   = {{emcee: The MCMC Hammer}},
  journal = {{Publications of the Astronomical Society of the Pacific}},
  volume  = {{125}}, pages = {{306--312}}, year = {{2013}}, doi = {{10.1086/670067}}
}}
@article{{kumar2019,
  author  = {{Kumar, Ravin and Carroll, Colin and Hartikainen, Ari and Martin, Osvaldo}},
  title   = {{ArviZ a unified library for exploratory analysis of Bayesian models in Python}},
  journal = {{Journal of Open Source Software}},
  volume  = {{4}}, number = {{33}}, pages = {{1143}}, year = {{2019}}, doi = {{10.21105/joss.01143}}
}}
"""

_TEXT = f"""{SOFTWARE}: Bayesian identification of the generalized Iwan model and diagnosis of the sim-to-real gap.
Model: M. Rajaei, H. Ahmadian, E. Tavakoli, Modeling and identification of nonlinear behavior of friction vibratory \
separators using Iwan model.
Sampler: D. Foreman-Mackey et al., emcee: The MCMC Hammer, PASP 125 (2013) 306, doi:10.1086/670067.
Diagnostics: R. Kumar et al., ArviZ, J. Open Source Softw. 4(33) (2019) 1143, doi:10.21105/joss.01143."""


class Citation(str):
    """The text of a citation, shown as lines rather than as a quoted string; `bibtex` is for a reference manager."""

    __slots__ = ()

    @property
    def bibtex(self) -> str:
        return _BIBTEX

    def __repr__(self) -> str:
        return "\n".join(map(wrapped, self.splitlines()))

    def _repr_html_(self) -> str:
        return "".join(f"<p>{escape(line)}</p>" for line in self.splitlines())


def cite() -> Citation:
    """How to cite the package.

    Returns
    -------
    Citation
        its text; `cite().bibtex` for BibTeX.

    Examples
    --------
    >>> import bayes_iwan as bi
    >>> print(bi.cite().splitlines()[0][:10])
    bayes-iwan
    """
    return Citation(_TEXT)
