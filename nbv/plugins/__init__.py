"""Parts that other packages bring: scorers, gates, renderers, dense backends, metrics, samplers, fidelities and families.

``registry`` finds every part by its group and name, built in or brought; ``importing`` guards the import of other people's
modules; ``guards`` checks what their parts return and gives them read-only copies. A part is somebody's unfinished code: it
may end its own mission, and nothing else. This room lies below the configuration and knows no built-in part.
"""

from nbv.plugins.guards import read_only
from nbv.plugins.importing import environment, error_text, own_process, shortened
from nbv.plugins.registry import (
    GROUPS,
    INTERFACE,
    Plugin,
    Registry,
    failure_of,
    installed,
    leave_out,
    left_out,
    plugin_specs,
    plugins,
    register,
    settings_class,
    use,
    used,
)

__all__ = [
    "GROUPS",
    "INTERFACE",
    "Plugin",
    "Registry",
    "environment",
    "error_text",
    "failure_of",
    "installed",
    "leave_out",
    "left_out",
    "own_process",
    "plugin_specs",
    "plugins",
    "read_only",
    "register",
    "settings_class",
    "shortened",
    "use",
    "used",
]
