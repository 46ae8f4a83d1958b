"""The control side: sets computed offline, the laws evaluated online, and the service."""

import runtime.early  # noqa: F401
