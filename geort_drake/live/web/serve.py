"""Opens the page's server, with a certificate if other machines reach it, and the page in the browser."""

import datetime as dt
import ipaddress
import os
import secrets
import socket
import ssl
import tempfile
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from geort_drake.console import say, warn
from geort_drake.errors import LiveError
from geort_drake.live.web.operator_station import OperatorStation
from geort_drake.live.web.server import WebServer

_LIFETIME = dt.timedelta(days=2)  # of the certificate
_PAGE = Path(__file__).parent / "static"


@contextmanager
def open_server(
    station: OperatorStation, page: Path, host: str, port: int, browser: bool
) -> Iterator[WebServer]:
    """Yields a server and prints its address, which contains its key; closes it at the end.

    Args:
        station: handles the page's messages.
        page: folder of the built page.
        host, port: address to listen on. TLS is used unless it is a loopback address.
        browser: whether to open the browser, if there is a display.

    Raises:
        LiveError: the server cannot listen there.
    """
    hosts = host_names(host)
    tls = None if is_loopback(host) else self_signed_context(hosts)
    key = secrets.token_urlsafe(16)
    server = WebServer(station, host, port, key, page, tls)
    try:
        name = f"[{hosts[0]}]" if ":" in hosts[0] else hosts[0]
        address = f"{'https' if tls else 'http'}://{name}:{server.port}/#{key}"
        if tls:
            warn(
                "the page is open to the network: whoever has this address moves the robot. The browser will "
                "not know the certificate; accept it on your own devices only"
            )
        say(f"Hold up your hand: {address}")
        if browser and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            webbrowser.open(address)
        yield server
    finally:
        server.close()


def find_page() -> Path:
    """Returns the folder of the built page.

    It is part of the package where it was built with Node.js; `make live` in a clone builds it, too, which
    also serves a package installed elsewhere if the command runs in the clone.

    Raises:
        LiveError: there is no built page; the message says how to build it.
    """
    folder = Path.cwd()
    clones = (parent / "geort_drake/live/web/static" for parent in (folder, *folder.parents))
    for page in (_PAGE, *clones):
        if (page / "index.html").is_file():
            return page
    raise LiveError(
        "the page is not installed, because geort-drake was installed without Node.js. Install Node.js 20 or "
        "newer (https://nodejs.org). Then run `make live` in a clone and start the command there, or install "
        "again: pip install --force-reinstall --no-deps '.[live]'. A glove needs no page: see --glove"
    )


def is_loopback(host: str) -> bool:
    """Returns whether only this machine can reach an address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def host_names(host: str) -> list[str]:
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
    """Returns TLS settings with a new key and a self-signed certificate, valid for two days."""
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
        .add_extension(x509.SubjectAlternativeName([_name(host) for host in hosts]), critical=False)
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


def _name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)
