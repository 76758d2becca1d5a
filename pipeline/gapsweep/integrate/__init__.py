"""Integration in time: engines, and the trajectories that they compute from initial states."""
