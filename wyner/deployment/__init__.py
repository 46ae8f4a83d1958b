"""Certificates, access control, and the supervisor of services."""
