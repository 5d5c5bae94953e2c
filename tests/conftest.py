"""Properties are tried with the same examples every time, so that what fails here fails everywhere.

Others are drawn with `--hypothesis-profile explore`, to look for those that fail.
"""

from __future__ import annotations

from hypothesis import HealthCheck, settings

# Whether an example passes must not depend on how fast the machine is, nor on what else it does.
settings.register_profile("explore", deadline=None, suppress_health_check=[HealthCheck.too_slow], print_blob=True)
settings.register_profile("same", settings.get_profile("explore"), derandomize=True)
settings.load_profile("same")
