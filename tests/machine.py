"""The paper's machine as the table of a study, and in TOML."""

PAPER = {"mass": 3.0, "omega_n": 5.0, "zeta": 0.03, "forcing": 4.0, "alpha": 7e8}
TOML = "{ mass = 3.0, omega_n = 5.0, zeta = 0.03, forcing = 4.0, alpha = 7e8 }"
