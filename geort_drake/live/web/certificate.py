"""Makes a certificate for a server that other machines in the network reach."""

import datetime as dt
import importlib
import ipaddress
import os
import socket
import ssl
import tempfile
from pathlib import Path

from geort_drake.errors import LiveError

_LIFETIME = dt.timedelta(days=2)


def own_addresses(host: str) -> list[str]:
    """Returns the names by which other machines reach `host`, which may stand for all interfaces."""
    if host not in ("0.0.0.0", "::"):
        return [host]
    family = socket.AF_INET if host == "0.0.0.0" else socket.AF_INET6
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            # Nothing is sent; the system chooses the interface. The address is reserved for documentation.
            probe.connect(("192.0.2.1" if family == socket.AF_INET else "2001:db8::1", 9))
            return [probe.getsockname()[0], socket.gethostname()]
        except OSError:
            return [socket.gethostname()]


def self_signed_context(hosts: list[str]) -> ssl.SSLContext:
    """Returns TLS settings with a new key and a self-signed certificate, valid for two days.

    Raises:
        LiveError: the package cryptography is not installed.
    """
    try:
        x509 = importlib.import_module("cryptography.x509")
        from cryptography.hazmat.primitives import hashes, serialization
        from cryptography.hazmat.primitives.asymmetric import ec
    except ImportError:
        raise LiveError("a certificate needs cryptography: pip install 'geort-drake[live]'") from None
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "geort-drake live")])
    now = dt.datetime.now(dt.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - dt.timedelta(hours=1))
        .not_valid_after(now + _LIFETIME)
        .add_extension(x509.SubjectAlternativeName([_name(x509, host) for host in hosts]), critical=False)
        .sign(key, hashes.SHA256())
    )
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    pem = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    ) + certificate.public_bytes(serialization.Encoding.PEM)
    # ssl reads keys only from files; only the user can read a temporary directory.
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "key.pem"
        path.write_bytes(pem)
        os.chmod(path, 0o600)
        context.load_cert_chain(path)
    return context


def _name(x509, host: str):  # type: ignore[no-untyped-def]
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)
