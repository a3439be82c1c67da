"""The page of settings says what the core knows."""

from pathlib import Path

from palmar import _runtime

PAGE = Path(__file__).resolve().parents[2] / "docs" / "settings.md"


def test_the_page_names_every_setting_with_its_default_and_no_other() -> None:
    rows = [line.split("|")[1:3] for line in PAGE.read_text().splitlines() if line.startswith("| `")]
    page = {name.strip().strip("`"): default.strip() for name, default in rows}
    known = _runtime.default_settings()
    assert sorted(page) == sorted(known)
    for name, default in known.items():
        assert page[name] == default if isinstance(default, str) else float(page[name]) == default, name
