// Sources of the page's parts: the document itself, or separate files on a web server.

async function unpacked(element) {
  const bytes = Uint8Array.from(atob(element.textContent), (letter) => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip")));
}

// Response with the part that has this id in the document, or else with the file.
export async function part(id, file) {
  const element = document.getElementById(`packed-${id}`);
  if (element) return unpacked(element);
  const response = await fetch(file);
  if (!response.ok) throw new Error(`${file} cannot be read: ${response.status}`);
  return response;
}
