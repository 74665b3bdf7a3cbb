"""The live web page in Chromium, against a stub of its server and the server itself."""

import io
import json
import signal
import time

import numpy as np
import pytest
from grasp_setup import planned_goal
from live_messages import in_world, joints_of, station
from live_page import (
    CHROMIUM,
    PAGE,
    WEB,
    PagePerson,
    StubServer,
    film_hand,
    launch,
    live_program,
    new_page,
    require_package,
    require_page,
    serve,
)
from PIL import Image

from geort_drake.live.web.hands import HandReader
from geort_drake.live.web.messages import Pointer, decode
from geort_drake.live.web.server import WebServer
from geort_drake.people.formats import KEYPOINTS_OF_25
from geort_drake.people.keypoints import BONES
from geort_drake.retargeting import METHODS

PATIENCE_S = 300.0  # a simulated person at the page takes 90 s on two busy cores
NO_PICTURES = "test/no_pictures.js"


@pytest.fixture(scope="module")
def playwright():
    require_page()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as running:
        yield running


@pytest.fixture(scope="module")
def browser(playwright):
    browser = launch(playwright)
    yield browser
    browser.close()


@pytest.fixture(autouse=True)
def _close_pages(browser):
    yield
    for context in browser.contexts:
        context.close()


@pytest.fixture(scope="module")
def address():
    with serve(PAGE) as address:
        yield address


@pytest.fixture
def stub():
    return StubServer()


def open_page(browser, stub, address, *scripts, received=None):
    """A page at an address after scripts of web/; `received` is called with every message that it gets."""
    page = new_page(browser, viewport={"width": 800, "height": 480})
    for script in scripts:
        page.add_init_script(path=WEB / script)
    if stub:
        stub.attach(page)
    if received:
        page.on("websocket", lambda socket: socket.on("framereceived", received))
    page.goto(address)
    return page


def until(page, holds, interval_ms: int = 50) -> None:
    """Waits; the page's own `wait_for_function` evaluates strings, which the server's policy forbids."""
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline, f"the page says {page.inner_text('body')!r}"
        page.wait_for_timeout(interval_ms)


def directions(points: np.ndarray) -> np.ndarray:
    """Unit vectors of the `BONES` of keypoints (21, 3)."""
    parents, children = np.array(BONES).T
    bones = points[children] - points[parents]
    return bones / np.linalg.norm(bones, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def filmed(playwright, browser, address, tmp_path_factory):
    """What the page sends of a film, and the rendered joints (T, 25, 3) at the same time, m."""
    require_package("@webxr-input-profiles/assets")
    file = tmp_path_factory.mktemp("film") / "hand.mjpeg"
    joints = film_hand(browser, file)
    stub = StubServer()
    camera = launch(playwright, file)
    page = open_page(camera, stub, f"{address}/#key", "test/read_numbers.js")
    page.wait_for_selector("body[data-state=tracking]")
    # Of a whole run of the film, which takes 2 s.
    until(page, lambda: len(seen := stub.of("camera")) >= 20 and seen[-1]["t"] - seen[0]["t"] > 2.2)
    messages = stub.of("camera")
    numbers = dict(page.evaluate("numbers"))
    camera.close()
    hosts = {url.split("/")[2] for url in stub.requests}
    assert hosts == {address.split("/")[2]}, "no request leaves the machine"
    return messages, joints[[numbers[message["t"]] for message in messages]]


@pytest.mark.slow
def test_camera_sees_the_rendered_bones(filmed):
    messages, joints = filmed
    errors = []
    for message, rendered in zip(messages, joints[:, KEYPOINTS_OF_25], strict=True):
        a, b = directions(np.array(message["world"])), directions(rendered)
        u, _, v = np.linalg.svd(a.T @ b)
        rotation = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
        errors.append(np.degrees(np.arccos(np.clip(np.sum(a @ rotation * b, axis=1), -1, 1))))
    assert np.median(errors) < 15
    assert np.quantile(errors, 0.9) < 35


@pytest.mark.slow
def test_the_robot_pinches_when_the_film_does(filmed, allegro):
    messages, joints = filmed
    retarget = METHODS["dexpilot"].fit(allegro)
    reader = HandReader("right")
    frames = [reader.read(decode(json.dumps(message))) for message in messages]
    gaps = np.linalg.norm(joints[:, 4] - joints[:, 9], axis=1)
    closed, opened = np.flatnonzero(gaps < 0.015)[:3], np.flatnonzero(gaps > 0.09)[:3]
    q = np.stack([retarget(frames[i].p_HK) for i in (*closed, *opened)])
    thumb, index = (allegro.finger_names.index(name) for name in ("thumb", "index"))
    tips = allegro.fingertips(q)
    robot = np.linalg.norm(tips[:, thumb] - tips[:, index], axis=1)
    assert np.median(robot[: len(closed)]) < 0.02
    assert np.median(robot[len(closed) :]) > 0.08


@pytest.fixture
def headset(browser, stub):
    """Opens the page in an emulated headset that sees `hands`: side → joints (25, 3)."""
    require_package("iwer")

    def open_headset(address, hands, stub=stub, key="key", received=None):
        scripts = "node_modules/iwer/build/iwer.min.js", "test/headset.js", NO_PICTURES
        page = open_page(browser, stub, f"{address}/#{key}", *scripts, received=received)
        page.click("#headset")
        until(page, lambda: page.evaluate("Boolean(window.session)"))
        page.evaluate("hands => play(hands)", hands)
        return page

    return open_headset


@pytest.mark.slow
def test_headset_sends_the_robots_side_in_order(headset, stub, address, rng):
    left, right = rng.uniform(-1, 1, (2, 25, 3)).round(3).tolist()
    page = headset(address, {"left": left, "right": right})
    page.wait_for_selector("body[data-state=tracking]")
    page.evaluate("hands => play(hands)", {"left": left})
    page.wait_for_selector("body[data-state=waiting]")
    until(page, lambda: "your left hand" in page.inner_text("#headline"))
    until(page, lambda: stub.messages[-1]["type"] == "lost")
    assert stub.of("hello")[-1]["device"] == "headset"
    np.testing.assert_allclose(stub.of("headset")[-1]["joints"], right, atol=1e-5)


@pytest.mark.slow
def test_a_headset_can_be_used_before_the_server_answers(headset, stub, address, rng):
    stub.silent = True
    page = headset(address, {"right": rng.uniform(-1, 1, (25, 3)).tolist()})
    stub.welcome(role="spectator")
    page.wait_for_selector("body[data-state=tracking]")
    until(page, lambda: stub.of("hello")[-1]["device"] == "headset")
    until(page, lambda: stub.of("headset"))
    stub.welcome(role="spectator")
    until(page, lambda: "watching" in page.inner_text("#headline"))
    sent = len(stub.of("headset"))
    page.evaluate(
        "new Promise((done) => { let n = 9;"
        "const frame = () => n-- ? session.requestAnimationFrame(frame) : done(); frame(); })"
    )
    assert len(stub.of("headset")) == sent


def test_a_real_robot_is_engaged_after_a_question(headset, stub, address, rng):
    page = headset(address, {"right": rng.uniform(-1, 1, (25, 3)).tolist()})
    page.wait_for_selector("body[data-state=tracking]")
    stub.welcome(robot="real")
    until(page, lambda: page.inner_text("#connection") == "Real robot")
    until(page, lambda: "The real robot will move" in page.inner_text("#headline"))
    for answer in ("cancel", "engage"):
        assert not stub.of("engage")
        page.keyboard.press(" ")
        page.click(f"dialog button[value={answer}]")
        page.wait_for_selector("dialog", state="hidden")
    page.evaluate("play({})")  # a message behind the others
    until(page, lambda: stub.messages[-1]["type"] == "lost")
    assert len(stub.of("engage")) == 2  # the server wants it twice


@pytest.mark.slow
def test_a_person_who_sees_only_the_page_grasps_the_cylinder(headset, tmp_path):
    """Page, server, diagram and physics: the command, a headset in the page, and the page's own messages.

    The person lives in real time, and grasps only where a core is free for the page and one for the server.
    """
    goal = planned_goal("cylinder")
    frames, texts = [], {}  # the newest text of each type

    def receive(message: bytes | str) -> None:
        if isinstance(message, bytes):
            frames.append(message)
        else:
            texts[json.loads(message)["type"]] = json.loads(message)

    with live_program(tmp_path) as (program, address, key):
        page = headset(address, {"right": joints_of(in_world(0))}, None, key, receive)
        until(page, lambda: "state" in texts and frames)
        until(page, lambda: page.get_attribute("body", "data-state") == "tracking")
        assert page.inner_text("#map") == "Universal map"
        scene = page.evaluate("fetch('scene').then((response) => response.json())")
        person = PagePerson(scene, texts["welcome"]["hand"], texts["state"]["object"], goal)

        def judged() -> bool:
            """One look at the page, and one movement."""
            if frames:
                new, frames[:] = frames[:], []
                joints = person.hand(new, texts["state"]["following"])
                page.evaluate("hands => play(hands)", {"right": joints})
            return texts["state"]["outcome"]["over"]

        page.keyboard.press(" ")
        until(page, judged, 5)
        outcome = texts["state"]["outcome"]
        assert outcome["success"] and outcome["phase"] == "done", person.phase
        until(page, lambda: "Done" in page.inner_text("#task"))
        program.send_signal(signal.SIGINT)
        report = json.loads(program.communicate(timeout=PATIENCE_S)[0])
    assert report["glove"]["refused"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("pictures", [1, 20])
def test_the_end_of_a_task_offers_a_clip_of_the_attempt(browser, stub, address, pictures):
    """A slow computer draws few pictures of it."""
    page = open_page(browser, stub, f"{address}/#key")
    page.wait_for_selector("body[data-state=waiting]")
    stub.send(engaged=True, following=True)
    unseen = np.full((21, 3), np.nan)
    for number in range(pictures):
        stub.socket.send(
            np.concatenate([[0.1 * number, 1, 0, 0, 0, 0.01 * number, 0, 0.05], unseen.ravel()])
            .astype("<f4")
            .tobytes()
        )
        page.wait_for_timeout(20)
    outcome = {"phase": "done", "score": 1.0, "seconds": 2.0, "over": True, "success": True}
    stub.send(engaged=True, following=True, outcome=outcome)
    page.wait_for_selector("#result")
    assert "Done in 2.0 s" in page.inner_text("#result") and "2.0 s (now)" in page.inner_text("#best")
    with page.expect_download() as download:
        page.click("#clip")
    assert download.value.path().stat().st_size > 1000


def test_a_simulated_person_is_watched_without_a_camera(browser, stub, address):
    page = open_page(browser, stub, f"{address}/#key", NO_PICTURES)
    page.click("#simulated")
    until(page, lambda: stub.of("hello")[-1]["device"] == "simulated")
    page.wait_for_selector("#headline:has-text('is getting ready')")
    stub.send(simulated_person=True, scene=2)
    page.wait_for_selector("#headline:has-text('A simulated person moves the robot')")
    outcome = {"phase": "done", "score": 1.0, "seconds": 2.0, "over": True, "success": True}
    stub.send(simulated_person=True, scene=2, outcome=outcome)
    page.wait_for_selector("#result:has-text('The simulated person did it')")
    assert page.inner_text("#best") == ""  # the times are the person's own
    stub.send(received=0, late=2, spectators=1)
    until(page, lambda: page.inner_text("#counts") == "1 watching")
    page.keyboard.press(" ")
    until(page, lambda: stub.of("hello")[-1]["device"] != "simulated")


@pytest.mark.slow
def test_the_view_shows_where_bodies_are(browser, stub, address):
    page = open_page(browser, stub, f"{address}/#key")
    page.wait_for_selector("body[data-state=waiting]")
    corners = page.locator("main").bounding_box()
    middle = {name: corners[name] + corners[size] / 4 for name, size in (("x", "width"), ("y", "height"))}
    middle |= {size: corners[size] / 2 for size in ("width", "height")}

    def dark_pixels() -> int:
        picture = np.array(Image.open(io.BytesIO(page.screenshot(clip=middle))).convert("L"))
        return np.sum(picture < 90)  # the hand's capsule is dark, as are words and the table's edge

    unseen = np.full((21, 3), np.nan)
    stub.send_poses(np.array([1, 0, 0, 0, 0, 0, 0.05]), unseen)
    until(page, lambda: dark_pixels() > 500)
    seen = dark_pixels()
    stub.send_poses(np.array([1, 0, 0, 0, 0, 0, -0.5]), unseen)  # under the table
    until(page, lambda: dark_pixels() < seen - 500)
    hidden = dark_pixels()
    stub.send_poses(np.array([1, 0, 0, 0, 0, 0, 0.05]), unseen)
    until(page, lambda: dark_pixels() > hidden + 500)


def test_a_browser_without_webgl_is_told_that_the_page_needs_it(playwright, stub, address):
    browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=["--disable-3d-apis"])
    page = open_page(browser, stub, f"{address}/#key")
    assert "needs WebGL 2" in page.inner_text("#no-webgl")
    browser.close()


@pytest.mark.slow
def test_an_old_address_is_refused_in_words(browser, stub):
    server = WebServer(station(), "127.0.0.1", 0, "key", PAGE)
    try:
        page = open_page(browser, None, f"http://127.0.0.1:{server.port}/#old", NO_PICTURES)
        until(page, lambda: "Wrong key: open the address" in page.inner_text("#headline"))
    finally:
        server.close()


@pytest.mark.slow
def test_a_camera_that_stops_or_comes_too_late_is_left_in_words(browser, stub, address):
    page = open_page(browser, stub, f"{address}/#key", "test/late_camera.js", NO_PICTURES)
    page.click("#camera")
    page.click("#camera")  # in spite of the browser's question
    page.evaluate("allow()")
    until(page, lambda: page.evaluate("given[0].readyState") == "ended")
    page.click("#camera")
    page.evaluate("allow()")
    page.wait_for_selector("#mirror canvas", state="attached")
    until(page, lambda: "The camera is starting" in page.inner_text("#headline"))
    page.evaluate("given[1].dispatchEvent(new Event('ended'))")
    until(page, lambda: page.inner_text("#start-words") == "The camera has stopped.")
    until(page, lambda: "Choose another way" in page.inner_text("#headline"))
    assert page.inner_text("#camera") == "Use the camera"


def test_the_mouse_moves_a_hand_and_the_state_is_told_without_contradictions(browser, stub, address):
    """Where it is over the view, and the grip that keys choose and the button closes."""
    page = open_page(browser, stub, f"{address}/#key", NO_PICTURES)
    page.wait_for_selector("body[data-state=waiting]")
    page.click("#pointer")
    page.wait_for_selector("body[data-state=tracking]")
    assert stub.of("hello")[-1]["device"] == "pointer"
    box = page.locator("#view").bounding_box()
    page.keyboard.press("2")
    page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 0.4 * box["height"])
    page.mouse.down()
    until(page, lambda: (seen := stub.of("pointer")) and seen[-1]["closed"])
    last = stub.of("pointer")[-1]
    assert (last["grip"], last["x"], last["y"]) == (
        "middle",
        pytest.approx(0.5, abs=0.02),
        pytest.approx(-0.2, abs=0.02),
    )
    assert isinstance(decode(json.dumps(last)), Pointer)
    page.mouse.up()
    for state, words in (
        ({"following": True, "status": "tracking"}, "Move your hand; the robot copies it."),
        ({"following": True, "status": "arm held: the wrist is too fast"}, "The arm waits"),
        ({"status": "held: the glove lost the hand", "slow": True}, "This computer is too slow."),
        ({"status": "held: no newer keypoints; messages arrive but are refused: too far"}, "Too far."),
        ({"status": "relaxing: no newer keypoints arrived in time"}, "This computer is too slow."),
    ):
        stub.send(engaged=True, **state)
        until(page, lambda words=words: words in page.inner_text("#headline"))


def test_whoever_uses_the_mouse_is_not_asked_for_a_hand(browser, stub, address):
    """Not even before a slow computer sends the first one: this page has no clock that would."""
    page = new_page(browser)
    page.add_init_script("window.setInterval = () => 0")
    stub.attach(page)
    page.goto(f"{address}/#key")
    page.wait_for_selector("body[data-state=waiting]")
    page.click("#pointer")
    until(page, lambda: "The coloured hand appears" in page.inner_text("#headline"))


def test_a_finger_on_a_touch_screen_moves_a_hand_and_taps_its_grips(browser, stub, address):
    """A finger that rests on the view does not close the hand; a tap on a grip does, and another opens it."""
    page = new_page(browser, viewport={"width": 400, "height": 800}, has_touch=True, is_mobile=True)
    page.add_init_script(path=WEB / NO_PICTURES)
    stub.attach(page)
    page.goto(f"{address}/#key")
    page.wait_for_selector("body[data-state=waiting]")
    assert page.inner_text("#pointer") == "Use your finger"
    page.tap("#pointer")
    page.wait_for_selector("body[data-state=tracking]")
    box = page.locator("#view").bounding_box()
    screen = page.context.new_cdp_session(page)

    def touch(kind: str, *shares: tuple[float, float]) -> None:
        points = [{"x": box["x"] + x * box["width"], "y": box["y"] + y * box["height"]} for x, y in shares]
        screen.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch("touchStart", (0.5, 0.5))
    touch("touchMove", (0.75, 0.4))
    until(page, lambda: (seen := stub.of("pointer")) and seen[-1]["x"] > 0.4)
    last = stub.of("pointer")[-1]
    assert not last["closed"]
    assert (last["x"], last["y"]) == (pytest.approx(0.5, abs=0.02), pytest.approx(-0.2, abs=0.02))
    touch("touchEnd")
    page.tap("[data-grip=ring]")
    until(page, lambda: stub.of("pointer")[-1]["closed"])
    assert stub.of("pointer")[-1]["grip"] == "ring"
    page.fill("#reach", "0.5")
    until(page, lambda: stub.of("pointer")[-1]["z"] == 0.5)
    page.tap("[data-grip=ring]")
    until(page, lambda: not stub.of("pointer")[-1]["closed"])
    # The end of a touch suffices, because a browser may send no click after it.
    page.dispatch_event("[data-grip=ring]", "touchend")
    until(page, lambda: stub.of("pointer")[-1]["closed"])
    assert page.evaluate("document.documentElement.scrollWidth") == 400


def test_panel_and_keys(browser, stub, address):
    page = open_page(browser, stub, f"{address}/#key", NO_PICTURES)
    page.wait_for_selector("body[data-state=waiting]")
    until(page, lambda: "Hold up your right hand" in page.inner_text("#headline"))
    assert page.is_disabled("#engage")

    stub.send(engaged=True, following=False)
    page.wait_for_selector("body[data-state=lost]")
    until(page, lambda: "The robot holds until" in page.inner_text("#headline"))
    page.keyboard.press("r")
    page.select_option("#object", "sphere")
    page.select_option("#task-name", "keys")
    until(page, lambda: "Setting up" in page.inner_text("#headline"))
    cue = {"phase": "key 2", "score": 0.1, "seconds": None, "over": False, "success": False}
    stub.send(scene=2, task="keys", object="keys", outcome=cue, engaged=True, following=True)
    page.wait_for_selector("#object", state="hidden")
    until(page, lambda: "Setting up" not in page.inner_text("#headline"))
    assert "Key 2" in page.inner_text("#task")
    assert page.inner_text("#purpose") == "Press a key"
    page.focus("#reset")
    page.keyboard.press(" ")  # disengages, although a button has the focus
    until(page, lambda: len(stub.of("disengage")) == 1)
    choices = {}, {"object": "sphere"}, {"task": "keys"}
    assert stub.of("reset") == [{"type": "reset", **choice} for choice in choices]

    stub.welcome(mounts=["arm", "floating"])
    stub.send(scene=2, task="keys", object="keys", mount="floating")
    until(page, lambda: page.input_value("#mount") == "floating" and page.is_disabled("#mount"))

    assert page.is_disabled("#record")
    page.check("#keep")
    page.click("#record")
    until(page, lambda: stub.of("record"))
    assert len(stub.of("disengage")) == 1
    outcome = {"phase": "done", "score": 1.0, "seconds": 21.0, "over": True, "success": True}
    stub.send(scene=2, outcome=outcome, recording="session.npz")
    page.wait_for_selector("body[data-recording]")
    assert "Done" in page.inner_text("#task")
    assert page.inner_text("#result-title") == "Done in 21.0 s"
    assert page.inner_text("#best") == "21.0 s (now)"
    stub.send(scene=3)
    stub.send(scene=3, outcome=outcome | {"seconds": 17.5})
    until(page, lambda: page.inner_text("#best").split("\n") == ["17.5 s (now)", "21.0 s"])
    failed = {"success": False, "score": 0.4, "seconds": None, "reason": "the object fell"}
    stub.send(scene=3, outcome=outcome | failed, time=31.0)
    until(page, lambda: page.inner_text("#result-title") == "Not this time: ended after 31.0 s")
    assert page.inner_text("#result-words") == "You came 40 % of the way. The object fell."
    assert page.inner_text("#best").split("\n") == ["17.5 s", "21.0 s"]
    for button in ("#again", "#watch", "#clip"):
        assert page.is_enabled(button)
    assert stub.of("record") == [{"type": "record", "keep": True}]

    stub.welcome(side="left")
    stub.send()
    until(page, lambda: "Hold up your left hand" in page.inner_text("#headline"))

    stub.welcome(role="spectator", side="left")
    until(page, lambda: "watching" in page.inner_text("#headline"))
    hellos = len(stub.of("hello"))
    stub.send(operator=False)
    until(page, lambda: "Nobody has the controls" in page.inner_text("#headline"))
    page.keyboard.press(" ")
    until(page, lambda: len(stub.of("hello")) == hellos + 1)
    stub.socket.close()
    page.wait_for_selector("body[data-state=connecting]")
