"""Every Hypothesis strategy of the test suite."""

from hypothesis import strategies as st

from gapsweep import Gap
from gapsweep.model.laws import LAWS

distances = st.floats(0.0, 2e-3)
gaps = st.builds(Gap, distances, distances)
symmetric_gaps = distances.map(lambda j: Gap(j, j))
stiffnesses = st.floats(1.0, 1e7)
displacements = st.floats(-4e-3, 4e-3)
convergences = st.integers(2, 7).map(lambda e: f"1e{e}")
smooth_labels = st.builds(
    "{}-{}".format, st.sampled_from([law.family for law in LAWS if law.is_sharpened]), convergences
)
fitted_labels = st.sampled_from(["poly-1", "poly-13", "poly-60", "ratpoly-3/2"])
