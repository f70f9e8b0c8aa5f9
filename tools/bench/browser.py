"""A real browser without a screen, for tests and benchmarks of the map's page."""

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from selenium.webdriver import Chrome

WORDS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-quic", "--force-device-scale-factor=1",
)  # fmt: skip
SIZE = (1440, 900)
WAIT_S = 30.0


def missing() -> str:
    """What this machine lacks for it, as one reason; empty: nothing."""
    try:
        import selenium  # noqa: F401
    except ImportError:
        return "selenium is not installed"
    for name in ("chromium", "chromedriver"):
        if shutil.which(name) is None:
            return f"{name} is not installed"
    return ""


@contextlib.contextmanager
def browser(size: tuple[int, int] = SIZE) -> "Iterator[Chrome]":
    """Chromium with an empty profile; it ends with the context."""
    from selenium.webdriver import Chrome, ChromeOptions
    from selenium.webdriver.chrome.service import Service

    options = ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        for word in (*WORDS, f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}"):
            options.add_argument(word)
        driver = Chrome(options=options, service=Service(shutil.which("chromedriver")))
        driver.set_script_timeout(WAIT_S)
        try:
            yield driver
        finally:
            driver.quit()


def open_page(driver: "Chrome", url: str, seconds: float = WAIT_S) -> None:
    """Wait for a server that is only starting, too. TimeoutError."""
    from selenium.common.exceptions import TimeoutException, WebDriverException
    from selenium.webdriver.support.ui import WebDriverWait

    def there(page: "Chrome") -> bool:
        try:
            page.get(url)
        except WebDriverException:
            return False
        return True

    try:
        WebDriverWait(driver, seconds, 0.5).until(there)
    except TimeoutException:
        raise TimeoutError(f"nobody serves {url}") from None


def until(driver: "Chrome", script: str, seconds: float = WAIT_S) -> Any:
    """What the expression is once it is true in the page. TimeoutError."""
    from selenium.common.exceptions import TimeoutException
    from selenium.webdriver.support.ui import WebDriverWait

    loaded = "document.readyState === 'complete'"  # before, the page's own script may not have run
    try:
        return WebDriverWait(driver, seconds, 0.1).until(
            lambda page: page.execute_script(f"return {loaded} && ({script});")
        )
    except TimeoutException:
        raise TimeoutError(f"never true in the page: {script}") from None


def complaints(driver: "Chrome") -> list[str]:
    """What the page has put on its console as errors: of scripts, policy and missing files."""
    lines = driver.get_log("browser")  # type: ignore[no-untyped-call]
    return [str(line["message"]) for line in lines if line["level"] == "SEVERE"]
