"""Plants as files, and in ``plants.py`` the functions that some of them name."""
