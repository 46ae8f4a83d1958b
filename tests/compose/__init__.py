"""The system in containers, for real; see conftest.py."""
