"""Settings of the property tests: the same examples each time, and no search for smaller ones."""

from hypothesis import Phase, settings

settings.register_profile(
    "hebbviz",
    deadline=None,
    derandomize=True,
    database=None,
    phases=(Phase.explicit, Phase.generate),
)
settings.load_profile("hebbviz")
