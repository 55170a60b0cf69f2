// Browsers start no worker for a page that is opened from disk. There the search runs in a hidden frame, which has the same messages.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    #frame = document.createElement("iframe");
    #ready;

    constructor(url) {
      super();
      this.#frame.hidden = true;
      document.body.append(this.#frame);
      const inside = this.#frame.contentWindow;
      // Opened from the page, the frame's document has its origin. There importScripts waits for nothing, and postMessage goes to the page.
      inside.document.open();
      inside.document.write(
        `<body><script>
          postMessage = (data) => parent.postMessage(data, "*");
          importScripts = (...urls) => Promise.all(urls.map((url) => new Promise((done) => {
            const script = document.createElement("script");
            script.src = url; script.onload = done; document.body.append(script);
          })));
        </` + `script><script src="${url}"></` + `script></body>`,
      );
      inside.document.close();
      this.#ready = new Promise((done) => inside.addEventListener("load", done));
      addEventListener("message", (event) => {
        if (event.source === inside) this.dispatchEvent(new MessageEvent("message", { data: event.data }));
      });
    }

    async postMessage(data) {
      await this.#ready;
      this.#frame.contentWindow.dispatchEvent(new MessageEvent("message", { data: structuredClone(data) }));
    }

    terminate() {
      this.#frame.remove();
    }
  };
}
