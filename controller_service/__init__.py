"""The control side: sets computed offline, the two laws evaluated online, and the service."""
