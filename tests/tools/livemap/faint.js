// For execute_script: texts whose contrast with their ground is less than WCAG 2.2 AA asks for.
const LEAST = 4.5, LEAST_LARGE = 3, LARGE_PX = 24, LARGE_BOLD_PX = 18.66;

const parse = (text) => text.match(/[\d.]+/g).map(Number);
const over = ([r, g, b, a = 1], [R, G, B]) => [r * a + R * (1 - a), g * a + G * (1 - a), b * a + B * (1 - a)];

function luminance(rgb) {
  const [r, g, b] = rgb.map((v) => (v / 255 <= 0.04045 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

function* upwards(node) { for (let each = node; each; each = each.parentElement) yield getComputedStyle(each); }

function ground(node) {
  const layers = [...upwards(node)].map((style) => parse(style.backgroundColor));
  return layers.reverse().reduce((below, layer) => over(layer, below), [0, 0, 0]);
}

const found = [], walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walk.nextNode()) {
  const node = walk.currentNode.parentElement, text = walk.currentNode.textContent.trim();
  if (!text || !node.checkVisibility()) continue;
  const style = getComputedStyle(node), below = ground(node), size = parseFloat(style.fontSize);
  const [more, less] = [luminance(over(parse(style.color), below)), luminance(below)].sort((x, y) => y - x);
  const ratio = (more + 0.05) / (less + 0.05), bold = Number(style.fontWeight) >= 700;
  const least = size >= LARGE_PX || (bold && size >= LARGE_BOLD_PX) ? LEAST_LARGE : LEAST;
  const faded = [...upwards(node)].some((each) => Number(each.opacity) < 1);
  if (faded || ratio < least) found.push(`${node.id || node.className || node.tagName}: ${text} ${ratio.toFixed(2)}`);
}
return found;
