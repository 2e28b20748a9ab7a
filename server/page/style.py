"""The style of viser's page, three short scripts, and messages for a lost server or lost graphics.

The selectors use the class names of Mantine, viser's widget library.
"""

from __future__ import annotations

from hebbviz.server.page import camera

STATUS_LINES = 4
"""Room for this many lines of status text, so that a shorter text moves nothing below it."""

GONE = """<div class="gone">The connection to the server is lost: this is the last frame.
Start hebbviz again and this page reconnects by itself.</div>"""
"""Shown when the page has lost the server; viser's page then disables its panels."""

LOST = """<style onload="document.addEventListener('webglcontextlost',
  () => document.body.classList.add('without-graphics'), true)"></style>
<div class="lost">The browser has lost its graphics context, so the scene is empty.
<a href="" onclick="location.reload()">Reload the page</a>.</div>"""
"""Shown once a browser has dropped the graphics context, for example after sleep or a driver fault;
viser does not rebuild its scene when the context returns.
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
"""In narrow windows viser puts its panels in a sheet over the scene, which no server can close; its
height is limited so that the scene stays visible above it, see `camera`.
"""

_SLIDERS = """
.mantine-Slider-root:not(:has(.mantine-Slider-markWrapper:nth-child(2):last-child))
  + .mantine-NumberInput-root { display: none; }
"""
"""The number box beside a slider is shown only if the slider's marks are its two ends. Other boxes
would show a logarithm, or a step with more digits than fit; those values have their own text field.
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
"""Buttons are plain unless they have a colour of their own."""

_LABELS = """
[data-mantine-color-scheme="light"] body { --mantine-color-dimmed: #5a6068; }
[data-mantine-color-scheme="dark"] body { --mantine-color-dimmed: #a4a8b0; }
"""
"""Labels with more contrast than viser's, at least 4.5 to 1."""

ARROWS = """<style onload="document.body.onkeydown = (event) => {
  if (event.key.startsWith('Arrow') && event.target.closest('[role=slider], [role=tab]'))
    event.stopPropagation(); }"></style>"""
"""Keeps an arrow key that moves a slider from turning the camera too."""

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
"""Keeps typed characters from viser, which would send every key, and keeps viser's values and
carets from a field in use. On Enter, or when the field loses focus, the browser fires a change
event; viser handles it and sends the whole value. Text that was typed and then reverted fires no
change event: the field then shows the value that arrived meanwhile. A number field takes only the
characters between the carets of the last key and now, so a synthetic key with everything selected
precedes the change.
"""

STYLE = f"<style>{_GONE}{_STATUS}{_SHEET}{_SLIDERS}{_BUTTONS}{_LABELS}</style>"
PAGE = f"{STYLE}{ARROWS}{WHOLE}{LOST}{GONE}"
"""Inserted above the status."""
