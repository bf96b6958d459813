/** Rectangles on shelves, for the pictures of surfaces (docs/payloads/bodycast.md, docs/payloads/lien2006.md). */

/** A rectangle, and the link that it belongs to. */
export interface Item {
  link: number;
  height: number;
  width: number;
  top: number;
  left: number;
}

/** Places items on shelves of this width, the tallest first. Returns the height of all shelves. */
export function shelve(items: Item[], across: number): number {
  let [left, top, shelf] = [0, 0, 0];
  for (const item of [...items].sort((a, b) => b.height - a.height || a.link - b.link)) {
    if (left + item.width > across) [left, top, shelf] = [0, top + shelf, 0];
    [item.top, item.left] = [top, left];
    left += item.width;
    shelf = Math.max(shelf, item.height);
  }
  return top + shelf;
}
