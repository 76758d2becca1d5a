"""Coefficients of the two explicit Runge-Kutta methods, in the form the stepping loop wants.

Both end with a stage at the new point ("first same as last"), so the last row of `a` is the
weight vector. For x' = v, v' = f the position sums are eliminated: with K_j the accelerations,

    X_i = x + c_i h v + h^2 sum_j abar_ij K_j,   V_i = v + h sum_j a_ij K_j,   abar = a @ a,

which is the same method with half the storage, and whose X_i does not wait for K_{i-1}.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

E5, E3, OTHER_E5 = 0, 1, 2


class Tableau(NamedTuple):
    """A Runge-Kutta pair for the compiled loop.

    Attributes
    ----------
    a, abar : ndarray, shape (n_stages, n_stages)
        Weights of the stage velocities and of the stage displacements (`a @ a`) [-].
    c : ndarray, shape (n_stages,)
        Nodes [-].
    e, ebar : ndarray, shape (3, n_stages)
        Weights of the error estimates of v and x, in the rows `E5`, `E3` and `OTHER_E5`; of a plain
        pair all but the first are zero.
    exponent : float
        Step factors go with error ** -exponent: one over (order of the estimate + 1).
    order : int
        Order of the advancing formula.
    """

    a: NDArray[np.float64]
    abar: NDArray[np.float64]
    c: NDArray[np.float64]
    e: NDArray[np.float64]
    ebar: NDArray[np.float64]
    exponent: float
    order: int


def _tableau(
    rows: list[dict[int, float]], estimates: list[dict[int, float]], exponent: float, order: int
) -> Tableau:
    n = len(rows)
    a, e = np.zeros((n, n)), np.zeros((3, n))
    for table, sparse in ((a, rows), (e, estimates)):
        for i, row in enumerate(sparse):
            table[i, list(row)] = list(row.values())
    return Tableau(a, a @ a, a.sum(axis=1), e, e @ a, exponent, order)


# Dormand & Prince, J. Comput. Appl. Math. 6 (1980) 19-26: the pair of ode45.
_DORMAND_PRINCE_5 = [
    {},
    {0: 1 / 5},
    {0: 3 / 40, 1: 9 / 40},
    {0: 44 / 45, 1: -56 / 15, 2: 32 / 9},
    {0: 19372 / 6561, 1: -25360 / 2187, 2: 64448 / 6561, 3: -212 / 729},
    {0: 9017 / 3168, 1: -355 / 33, 2: 46732 / 5247, 3: 49 / 176, 4: -5103 / 18656},
    {0: 35 / 384, 2: 500 / 1113, 3: 125 / 192, 4: -2187 / 6784, 5: 11 / 84},
]
_DORMAND_PRINCE_5_E = {
    0: 71 / 57600,
    2: -71 / 16695,
    3: 71 / 1920,
    4: -17253 / 339200,
    5: 22 / 525,
    6: -1 / 40,
}

# Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I (2nd ed.), section II.5:
# order 8 with estimates of order 5 and 3, combined as e5^2 / sqrt(e5^2 + 0.01 e3^2).
_DOP853 = [
    {},
    {0: 0.05260015195876773},
    {0: 0.0197250569845379, 1: 0.0591751709536137},
    {0: 0.02958758547680685, 2: 0.08876275643042054},
    {0: 0.2413651341592667, 2: -0.8845494793282861, 3: 0.924834003261792},
    {0: 0.037037037037037035, 3: 0.17082860872947386, 4: 0.12546768756682242},
    {0: 0.037109375, 3: 0.17025221101954405, 4: 0.06021653898045596, 5: -0.017578125},
    {
        0: 0.03709200011850479,
        3: 0.17038392571223998,
        4: 0.10726203044637328,
        5: -0.015319437748624402,
        6: 0.008273789163814023,
    },
    {
        0: 0.6241109587160757,
        3: -3.3608926294469414,
        4: -0.868219346841726,
        5: 27.59209969944671,
        6: 20.154067550477894,
        7: -43.48988418106996,
    },
    {
        0: 0.47766253643826434,
        3: -2.4881146199716677,
        4: -0.590290826836843,
        5: 21.230051448181193,
        6: 15.279233632882423,
        7: -33.28821096898486,
        8: -0.020331201708508627,
    },
    {
        0: -0.9371424300859873,
        3: 5.186372428844064,
        4: 1.0914373489967295,
        5: -8.149787010746927,
        6: -18.52006565999696,
        7: 22.739487099350505,
        8: 2.4936055526796523,
        9: -3.0467644718982196,
    },
    {
        0: 2.273310147516538,
        3: -10.53449546673725,
        4: -2.0008720582248625,
        5: -17.9589318631188,
        6: 27.94888452941996,
        7: -2.8589982771350235,
        8: -8.87285693353063,
        9: 12.360567175794303,
        10: 0.6433927460157636,
    },
    {
        0: 0.054293734116568765,
        5: 4.450312892752409,
        6: 1.8915178993145003,
        7: -5.801203960010585,
        8: 0.3111643669578199,
        9: -0.1521609496625161,
        10: 0.20136540080403034,
        11: 0.04471061572777259,
    },
]
_DOP853_E5 = {
    0: 0.01312004499419488,
    5: -1.2251564463762044,
    6: -0.4957589496572502,
    7: 1.6643771824549864,
    8: -0.35032884874997366,
    9: 0.3341791187130175,
    10: 0.08192320648511571,
    11: -0.022355307863886294,
}
_DOP853_E3 = {
    0: -0.18980075407240762,
    5: 4.450312892752409,
    6: 1.8915178993145003,
    7: -5.801203960010585,
    8: -0.4226823213237919,
    9: -0.1521609496625161,
    10: 0.20136540080403034,
    11: 0.02265179219836082,
}
# Of the combinations of stages that vanish up to order 5, the one whose errors of order 6 are as
# large as those of the first estimate and orthogonal to them, as sums over the 20 rooted trees:
# nearly half of what the two derivatives at the end of a step differ by.
_DOP853_OTHER_E5 = {
    0: -0.0039411232413551152,
    5: -0.047182942829604208,
    6: 0.065576635211826396,
    7: -0.038657288205519292,
    8: -0.072708459906989351,
    9: 0.096427420121502772,
    10: -0.0016768011031598717,
    11: -0.49807590786217684,
    12: 0.50023846781547551,
}

DP5 = _tableau(_DORMAND_PRINCE_5, [_DORMAND_PRINCE_5_E], exponent=1 / 5, order=5)
DOP853 = _tableau(_DOP853, [_DOP853_E5, _DOP853_E3, _DOP853_OTHER_E5], exponent=1 / 8, order=8)
