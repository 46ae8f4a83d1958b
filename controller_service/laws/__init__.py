"""Control laws evaluated online, at one state or at many."""
