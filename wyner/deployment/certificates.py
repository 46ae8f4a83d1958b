"""Certificates for mutual TLS: one authority, one certificate a service, made with ``openssl``.

The command line of OpenSSL 3 does the cryptography: it is in practically every system that can open
an HTTPS address, so no further dependency is carried for it.

A folder of certificates::

    ca.pem        the authority's certificate, the same for all
    ca-key.pem    its private key: needed to make more certificates, and by no service
    NAME/         what one service gets, whole: ca.pem, cert.pem, key.pem
"""

import ipaddress
import os
import re
import secrets
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from runtime.files import open_regular, read_regular

AUTHORITY_CERTIFICATE: Final = "ca.pem"
AUTHORITY_KEY: Final = "ca-key.pem"
CERTIFICATE: Final = "cert.pem"
KEY: Final = "key.pem"

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_HOST = re.compile(r"(?=.{1,253}$)[A-Za-z0-9_]([A-Za-z0-9_-]*[A-Za-z0-9_])?(\.[A-Za-z0-9_-]+)*")

AUTHORITY: Final = (
    "basicConstraints=critical,CA:TRUE,pathlen:0",
    "keyUsage=critical,keyCertSign,cRLSign",
    "subjectKeyIdentifier=hash",
)
SERVICE: Final = (
    "basicConstraints=critical,CA:FALSE",
    "keyUsage=critical,digitalSignature",
    "extendedKeyUsage=serverAuth,clientAuth",
    "subjectKeyIdentifier=hash",
    "authorityKeyIdentifier=keyid",
)
"""What a certificate may be used for, as OpenSSL writes it."""


class CertificateError(Exception):
    """A certificate that cannot be made; the text is one line with the reason."""


def check_name(name: str) -> None:
    """Refuse a name that cannot be a certificate's common name and a folder's name.

    Raises
    ------
    CertificateError
        When it is none.
    """
    if not _NAME.fullmatch(name):
        raise CertificateError(
            f"name: got {name!r}, expected 1 to 64 letters, digits, dots, dashes or underscores"
        )


def check_host(host: str) -> str:
    """Return ``host`` as OpenSSL writes it in a list of alternative names.

    Raises
    ------
    CertificateError
        When it is neither an address nor a host's name.
    """
    try:
        return f"IP:{ipaddress.ip_address(host)}"
    except ValueError:
        pass
    if not _HOST.fullmatch(host):
        raise CertificateError(f"host: got {host!r}, expected an IP address or a host's name")
    return f"DNS:{host}"


def make_authority(folder: Path, days: int) -> None:
    """Make the authority in ``folder``, unless it is there.

    Raises
    ------
    CertificateError
        When half of it is there, or ``openssl`` fails.
    """
    certificate, key = folder / AUTHORITY_CERTIFICATE, folder / AUTHORITY_KEY
    if certificate.exists() != key.exists():
        there, gone = (certificate, key) if certificate.exists() else (key, certificate)
        raise CertificateError(f"{there} is there and {gone} is not; expected both or neither")
    if certificate.exists():
        for path in (certificate, key):  # openssl would wait at a pipe
            open_regular(path).close()
        return
    # The name differs from one authority to the next, so that a certificate of an older one is
    # refused for its issuer and not for its signature.
    _make(folder, f"wyner authority {secrets.token_hex(4)}", days, key, certificate, AUTHORITY)


def make_certificate(folder: Path, name: str, hosts: Sequence[str], days: int) -> None:
    """Make ``folder/name`` with a fresh key and a certificate of the authority in ``folder``.

    Parameters
    ----------
    folder : Path
        Holds the authority (:func:`make_authority`).
    name : str
        Common name, by which access is granted.
    hosts : sequence of str
        Host names and addresses under which the service may be reached.
    days : int
        Days for which it is valid.

    Raises
    ------
    CertificateError
        When a host is not usable, or ``openssl`` fails.
    """
    names = ",".join(map(check_host, hosts))
    target, authority = folder / name, folder / AUTHORITY_CERTIFICATE
    extensions = (*SERVICE, f"subjectAltName={names}")
    signer = ("-CA", str(authority), "-CAkey", str(folder / AUTHORITY_KEY))
    _make(target, name, days, target / KEY, target / CERTIFICATE, extensions, signer)
    shutil.copyfile(authority, target / AUTHORITY_CERTIFICATE)


def _make(
    folder: Path,
    name: str,
    days: int,
    key: Path,
    certificate: Path,
    extensions: Sequence[str],
    signer: Sequence[str] = (),
) -> None:
    """A fresh key, and a certificate for it; it signs itself where there is no signer."""
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError as error:
        raise CertificateError(f"{folder}: cannot be made: {error.strerror}") from None
    with tempfile.TemporaryDirectory(dir=folder) as work:
        _openssl(
            *("req", "-x509", *signer, "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256"),
            *("-noenc", "-sha256", "-config", os.devnull, "-subj", f"/CN={name}"),
            *("-days", str(days), *(part for text in extensions for part in ("-addext", text))),
            *("-keyout", f"{work}/key", "-out", f"{work}/cert"),
        )
        # The key first: a certificate without its key would be taken for damage.
        (Path(work) / "key").replace(key)
        (Path(work) / "cert").replace(certificate)


def is_current(folder: Path, name: str) -> bool:
    """Whether ``folder/name`` is whole, of the authority in ``folder``, and valid for a day."""
    target, authority = folder / name, folder / AUTHORITY_CERTIFICATE
    if not all((target / file).exists() for file in (AUTHORITY_CERTIFICATE, CERTIFICATE, KEY)):
        return False
    if read_regular(target / AUTHORITY_CERTIFICATE) != read_regular(authority):
        return False
    certificate = str(target / CERTIFICATE)
    try:
        _openssl("verify", "-CAfile", str(authority), certificate)
        _openssl("x509", "-in", certificate, "-noout", "-checkend", str(24 * 3600))
    except CertificateError:
        return False
    return True


def ensure_certificates(folder: Path, hosts: Mapping[str, Sequence[str]], days: int) -> list[str]:
    """Make what is missing or about to end in ``folder``; the names that were made, in order.

    Parameters
    ----------
    folder : Path
    hosts : mapping
        Names, each checked by :func:`check_name`, with the hosts of :func:`make_certificate`.
    days : int
        Days for which they are valid.

    Raises
    ------
    CertificateError
        As :func:`make_authority` and :func:`make_certificate`.
    """
    make_authority(folder, days)
    missing = [name for name in hosts if not is_current(folder, name)]
    for name in missing:
        make_certificate(folder, name, hosts[name], days)
    return missing


def _openssl(*arguments: str) -> None:
    try:
        done = subprocess.run(
            ["openssl", *arguments],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
            stdin=subprocess.DEVNULL,
            env={**os.environ, "LC_ALL": "C"},
        )
    except FileNotFoundError:
        raise CertificateError("openssl: not found; expected the OpenSSL command line") from None
    except subprocess.TimeoutExpired:
        raise CertificateError(f"openssl {arguments[0]}: no answer within 60 s") from None
    if done.returncode != 0:
        said = done.stderr.strip().splitlines() or ["no reason given"]
        raise CertificateError(f"openssl {arguments[0]}: {said[0]}")
