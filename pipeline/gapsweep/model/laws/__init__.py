"""The approximations of the exact law, fits in one file and each other law in one.

A law is in the list `LAWS`, which labels, engines, advice, reports and the user guide read.
"""

from gapsweep.model.contact import ContactLaw, Piecewise
from gapsweep.model.laws.arctan import Arctan
from gapsweep.model.laws.fitted import Polynomial, RationalPolynomial
from gapsweep.model.laws.logarctan import LogArctan
from gapsweep.model.laws.tanh import Tanh

# In the order of the user guide.
LAWS: tuple[type[ContactLaw], ...] = (
    Piecewise,
    Polynomial,
    RationalPolynomial,
    Tanh,
    Arctan,
    LogArctan,
)
