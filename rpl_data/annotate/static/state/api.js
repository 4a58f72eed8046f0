// Requests to the server. A refusal becomes an Error with the server's message and status.

export async function get(path) {
  return read(await fetch(path, { cache: "no-cache" }));
}

export async function post(path, body) {
  return read(await fetch(path, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(body),
  }));
}

export async function binary(path, signal) {
  const answer = await fetch(path, { signal });
  if (!answer.ok) await read(answer);
  return answer.arrayBuffer();
}

async function read(answer) {
  const text = await answer.text();
  let content;
  try {
    content = JSON.parse(text);
  } catch {
    content = { error: text };
  }
  if (answer.ok) return content;
  const error = new Error(content.error || JSON.stringify(content.detail) || answer.statusText);
  error.status = answer.status;
  throw error;
}

// The scene of a place: what stands before the slash; behind it stands the instance, where a scene shows several.
export const sceneOf = (place) => place.split("/")[0];

export const objectPath = (name) => `/api/objects/${encodeURIComponent(name)}`;
export const scenePath = (place) => `/api/scenes/${encodeURIComponent(sceneOf(place))}`;
export const picturePath = (sceneName, frame, width) => `${scenePath(sceneName)}/frames/${frame}.jpg?width=${width}`;
