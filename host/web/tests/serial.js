// A Web Serial port whose other end is a program of the test: `window.board` is called with bytes for the board, and
// `window.fromBoard` takes bytes from it; both in base64.
(() => {
  class Port extends EventTarget {
    readable = null;
    writable = null;
    #incoming = null;

    getInfo = () => ({ usbVendorId: 0x1209, usbProductId: 0x0001 });
    setSignals = async () => {};

    async open() {
      if (!window.isPlugged) throw new DOMException("Failed to open serial port.", "NetworkError");
      if (this.readable) throw new DOMException("The port is already open.", "InvalidStateError");
      await window.board("open");
      this.readable = new ReadableStream({
        start: (controller) => (this.#incoming = controller),
        cancel: () => (this.readable = null),
      });
      this.writable = new WritableStream({ write: (bytes) => window.board(btoa(String.fromCharCode(...bytes))) });
    }

    async close() {
      this.readable = this.writable = this.#incoming = null;
      await window.board("close");
    }

    take(bytes) {
      this.#incoming?.enqueue(bytes);
    }

    unplug() {
      this.#incoming?.error(new DOMException("The device has been lost.", "NetworkError"));
      this.readable = this.#incoming = null;
    }
  }

  class Serial extends EventTarget {
    port = new Port();
    requestPort = async () => this.port;
    getPorts = async () => [this.port];
  }

  const serial = new Serial();
  Object.defineProperty(navigator, "serial", { value: serial });
  window.isPlugged = true;
  window.fromBoard = (text) => serial.port.take(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)));
  window.plug = (isPlugged) => {
    window.isPlugged = isPlugged;
    if (!isPlugged) serial.port.unplug();
    else {
      // Real ones bubble from the port.
      const event = new Event("connect");
      Object.defineProperty(event, "target", { value: serial.port });
      serial.dispatchEvent(event);
    }
  };
})();
