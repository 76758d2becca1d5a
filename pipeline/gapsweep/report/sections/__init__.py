"""The sections of the report: each module makes one, or one for each parameter set."""
