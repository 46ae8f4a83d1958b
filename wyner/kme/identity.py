"""Who is who: mutual TLS from a folder of certificates, and the name in the other end's."""

import ssl
from collections.abc import Mapping
from pathlib import Path


def tls_context(folder: Path, *, server: bool) -> ssl.SSLContext:
    """Mutual TLS, 1.2 or later, with ca.pem, cert.pem and key.pem of a folder.

    A client checks the host name besides.

    Raises
    ------
    OSError
        When one is not there or not what it should be.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER if server else ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.verify_mode = ssl.CERT_REQUIRED
    context.load_verify_locations(folder / "ca.pem")
    context.load_cert_chain(folder / "cert.pem", folder / "key.pem")
    return context


def common_name(certificate: Mapping[str, object] | None) -> str | None:
    """The common name of a peer's certificate, as ``getpeercert()`` gives it."""
    subject = (certificate or {}).get("subject", ())
    assert isinstance(subject, tuple)
    names = [value for part in subject for field, value in part if field == "commonName"]
    return names[0] if len(names) == 1 else None
