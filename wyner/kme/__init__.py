"""Delivery of keys: ETSI GS QKD 014 V1.1.1 over mutual TLS, each end with its own half."""
