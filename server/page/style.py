"""How viser's page is dressed: its style, three short scripts, and a word when the server or the
graphics are gone.

What viser draws is known here by the names that Mantine, its library, gives to the parts.
"""

from __future__ import annotations

from hebbviz.server.page import camera

STATUS_LINES = 4
"""Room for so many lines of the status, so that nothing below it moves when it says less."""

GONE = """<div class="gone">The server is gone: this picture is the last one. Start hebbviz again
and this page will go on by itself.</div>"""
"""viser's page makes its panels deaf when it loses the server; that is when this is shown."""

LOST = """<style onload="document.addEventListener('webglcontextlost',
  () => document.body.classList.add('without-graphics'), true)"></style>
<div class="lost">The browser has lost its graphics, and the scene is empty.
<a href="" onclick="location.reload()">Reload the page</a>.</div>"""
"""Shown once a browser has taken the graphics away, as after sleep or a fault of a driver; viser
does not make its scene again where it gives them back.
"""

_GONE = """
.gone, .lost { display: none; margin: 0 0.75em 0.5em; padding: 0.5em 0.75em; border-radius: 4px;
        background: #b00020; color: white; font-weight: 600; }
.lost a { color: inherit; }
[style*="pointer-events: none"] .gone, .without-graphics .lost { display: block; }
"""

_STATUS = f"""
div:has(> .gone) + div {{
  min-height: calc({1.3 * STATUS_LINES:g}em + var(--mantine-spacing-xs)); }}
"""

_SHEET = f"""
@media (max-width: 36em) {{
  .mantine-Paper-root[style*="max-height: 60%"] {{
    max-height: {100 * camera.SHEET:g}% !important; width: 100% !important; }}
  .mantine-Paper-root[style*="max-height: 60%"] [style*="width: 20em"] {{
    width: 100% !important; }}
}}
"""
"""Narrow windows have viser's panels in a sheet that opens over the scene, and that no server can
close; it is kept so low that the scene is seen above it, see `camera`.
"""

_SLIDERS = """
.mantine-Slider-root:not(:has(.mantine-Slider-markWrapper:nth-child(2):last-child))
  + .mantine-NumberInput-root { display: none; }
"""
"""The box beside a slider stays where its marks are its two ends. Elsewhere it would hold a
logarithm, or a step of more digits than it has room for; what may be typed has its own field.
"""

_BUTTONS = """
.mantine-Button-root[data-block]:not([style*="--button-bg"]),
.mantine-Button-root[data-variant="outline"] {
  --button-bg: transparent !important;
  --button-hover: var(--mantine-color-default-hover) !important;
  --button-color: var(--mantine-color-text) !important;
  --button-bd: 1px solid color-mix(in srgb, var(--mantine-color-dimmed) 60%, transparent)
    !important; }
"""
"""Buttons are quiet but for those that were given a colour."""

_LABELS = """
[data-mantine-color-scheme="light"] body { --mantine-color-dimmed: #5a6068; }
[data-mantine-color-scheme="dark"] body { --mantine-color-dimmed: #a4a8b0; }
"""
"""Labels of more contrast than viser's, at least 4.5 to 1."""

ARROWS = """<style onload="document.body.onkeydown = (event) => {
  if (event.key.startsWith('Arrow') && event.target.closest('[role=slider], [role=tab]'))
    event.stopPropagation(); }"></style>"""
"""An arrow key that moves a slider does not turn the camera too, which listens further out."""

WHOLE = """<style onload="if (!window.hebbvizTyping) {
  const held = window.hebbvizTyping = new Map();
  const isField = (field) => field.matches('.mantine-TextInput-input, .mantine-NumberInput-input')
    && field.closest('.mantine-Flex-root:has(label)');
  const hold = (field) => {
    const shown = Object.getOwnPropertyDescriptor(field, 'value');
    if (held.has(field) || !shown) return;
    const typing = {shown};
    held.set(field, typing);
    field.setSelectionRange = () => {};
    Object.defineProperty(field, 'value', {
      configurable: true, get: shown.get, set: (value) => { typing.late = value; }}); };
  const whole = (field) => {
    const end = field.value.length;
    field.setSelectionRange(0, end);
    field.dispatchEvent(new KeyboardEvent('keydown', {bubbles: true}));
    field.setSelectionRange(end, end); };
  const leave = (event) => {
    const field = event.target, typing = held.get(field);
    if (!typing) return;
    held.delete(field);
    Object.defineProperty(field, 'value', typing.shown);
    delete field.setSelectionRange;
    if (event.type === 'change') whole(field);
    else if ('late' in typing) field.value = typing.late; };
  const listen = (kind, act) => window.addEventListener(kind, act, true);
  const tell = (field) => field.dispatchEvent(new Event('change', {bubbles: true}));
  listen('pointerdown', (event) => {
    [...held.keys()].filter((field) => field !== event.target).forEach(tell);
    if (isField(event.target)) hold(event.target); });
  listen('input', (event) => {
    if (isField(event.target)) { event.stopPropagation(); hold(event.target); } });
  listen('keydown', (event) => {
    if (['ArrowUp', 'ArrowDown'].includes(event.key) && held.has(event.target))
      tell(event.target); });
  listen('change', leave);
  listen('focusout', leave); }"></style>"""
"""What is typed into a field is kept from viser, which would send every key; and viser's own values
and carets from a field that is clicked or typed into. On Enter and as the field is left, the
browser tells of a change; that viser hears, and sends the whole. What was typed and taken back is
no change: then the field shows what came late. A field for numbers takes only what changed since
the last key, between the carets then and now: so a key is made up at which all was selected.
"""

STYLE = f"<style>{_GONE}{_STATUS}{_SHEET}{_SLIDERS}{_BUTTONS}{_LABELS}</style>"
PAGE = f"{STYLE}{ARROWS}{WHOLE}{LOST}{GONE}"
"""To be put above the status."""
