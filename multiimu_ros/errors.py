"""The errors a user can meet; each message is one sentence that says what to do."""


class MultiImuError(Exception):
    """Base of every error that the package reports to its user; caught at the rim only."""


class ConfigError(MultiImuError):
    """A parameter or file is missing, unknown or out of range."""


class TransportError(MultiImuError):
    """A port cannot be opened, or went away."""


class CalibrationError(MultiImuError):
    """The recording cannot determine a parameter; says which, and what to record instead."""


class SyncError(MultiImuError):
    """Two streams cannot be put on one clock."""
