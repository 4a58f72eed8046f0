// What this browser remembers of its user, in cookies: workspaces that are opened from the page are served at other
// ports, where a page's own storage would be empty.

const YEAR_S = 365 * 24 * 3600;

export const kept = (name) => document.cookie.split("; ").find((pair) => pair.startsWith(`rpl_${name}=`))?.split("=")[1] ?? null;

export function keep(name, value) {
  document.cookie = `rpl_${name}=${value}; max-age=${YEAR_S}; path=/; samesite=strict`;
}
