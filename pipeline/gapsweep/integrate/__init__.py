"""How it is simulated: engines from an initial state to a trajectory."""
