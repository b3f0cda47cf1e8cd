// @ts-check
// sensor_msgs/Image as the browser shows pictures. Encodings: sensor_msgs/include/sensor_msgs/image_encodings.hpp of ROS 2.

/** Bytes per pixel. @type {Record<string, number>} */
const SIZES = {
  rgb8: 3, bgr8: 3, '8UC3': 3, rgba8: 4, bgra8: 4, '8UC4': 4, mono8: 1, '8UC1': 1, mono16: 2, '16UC1': 2, '32FC1': 4,
  yuv422: 2, uyvy: 2, yuv422_yuy2: 2, yuyv: 2, nv21: 1, nv12: 1, bayer_rggb8: 1, bayer_bggr8: 1, bayer_gbrg8: 1, bayer_grbg8: 1,
};
/** Where red, green and blue are in a square of two by two pixels. @type {Record<string, number[]>} */
const BAYER = { bayer_rggb8: [0, 1, 2, 3], bayer_bggr8: [3, 1, 2, 0], bayer_gbrg8: [2, 0, 3, 1], bayer_grbg8: [1, 0, 3, 2] };
const OPAQUE = 0xff000000;

/** @param {number} value */
const byte = (value) => (value < 0 ? 0 : value > 255 ? 255 : value | 0);
/** BT.601, as OpenCV converts. @param {number} y @param {number} u @param {number} v */
function yuv(y, u, v) {
  const [c, d, e] = [1.164 * (y - 16), u - 128, v - 128];
  return OPAQUE | (byte(c + 2.018 * d) << 16) | (byte(c - 0.391 * d - 0.813 * e) << 8) | byte(c + 1.596 * e);
}

/**
 * Writes a picture as pixels of red, green, blue and alpha.
 * @param {{ width: number, height: number, encoding: string, is_bigendian: number, step: number, data: Uint8Array }} image
 * @param {Uint32Array} out of `width × height`
 * @throws {Error} in words, if the encoding is unknown or bytes are missing
 */
export function pixels({ width, height, encoding, is_bigendian: isBig, step, data }, out) {
  const size = SIZES[encoding];
  if (size === undefined) throw new Error(`pictures in "${encoding}" are not shown`);
  const stride = step || width * size;
  const needed = encoding.startsWith('nv') ? stride * height + stride * Math.ceil(height / 2) : stride * (height - 1) + width * size;
  if (stride < width * size || data.length < needed) throw new Error(`a picture of ${width} × ${height} in ${encoding} has only ${data.length} bytes`);
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const depth = size === 2 ? (/** @type {number} */ at) => view.getUint16(at, !isBig) : (/** @type {number} */ at) => view.getFloat32(at, !isBig);
  let [least, most] = [0, 65535];
  if (encoding === '32FC1' || encoding === '16UC1') {
    [least, most] = [Infinity, -Infinity];
    for (let y = 0; y < height; y++) {
      for (let x = 0; x < width; x++) {
        const value = depth(y * stride + x * size);
        if (Number.isFinite(value) && value > 0) { least = Math.min(least, value); most = Math.max(most, value); }
      }
    }
  }
  for (let y = 0; y < height; y++) {
    let at = y * stride;
    let to = y * width;
    switch (encoding) {
      case 'rgb8':
        for (let x = 0; x < width; x++, at += 3) out[to++] = OPAQUE | (data[at + 2] << 16) | (data[at + 1] << 8) | data[at];
        break;
      case 'bgr8': case '8UC3':
        for (let x = 0; x < width; x++, at += 3) out[to++] = OPAQUE | (data[at] << 16) | (data[at + 1] << 8) | data[at + 2];
        break;
      case 'rgba8':
        for (let x = 0; x < width; x++, at += 4) out[to++] = OPAQUE | (data[at + 2] << 16) | (data[at + 1] << 8) | data[at];
        break;
      case 'bgra8': case '8UC4':
        for (let x = 0; x < width; x++, at += 4) out[to++] = OPAQUE | (data[at] << 16) | (data[at + 1] << 8) | data[at + 2];
        break;
      case 'mono8': case '8UC1':
        for (let x = 0; x < width; x++, at++) out[to++] = OPAQUE | (data[at] * 0x010101);
        break;
      case 'mono16': case '16UC1': case '32FC1':
        for (let x = 0; x < width; x++, at += size) {
          const value = depth(at);
          out[to++] = OPAQUE | (byte(((value - least) / (most - least || 1)) * 255) * 0x010101);
        }
        break;
      case 'yuv422': case 'uyvy': case 'yuv422_yuy2': case 'yuyv': {
        const [y0, u, y1, v] = encoding === 'yuv422' || encoding === 'uyvy' ? [1, 0, 3, 2] : [0, 1, 2, 3];
        for (let x = 0; x + 1 < width; x += 2, at += 4) {
          out[to++] = yuv(data[at + y0], data[at + u], data[at + v]);
          out[to++] = yuv(data[at + y1], data[at + u], data[at + v]);
        }
        break;
      }
      case 'nv12': case 'nv21': {
        const chroma = stride * height + (y >> 1) * stride;
        const [u, v] = encoding === 'nv12' ? [0, 1] : [1, 0];
        for (let x = 0; x < width; x++) { const pair = chroma + (x & ~1); out[to++] = yuv(data[at + x], data[pair + u], data[pair + v]); }
        break;
      }
      default: {
        // Each pixel takes the colours of its square: half the resolution, but right colours.
        const order = BAYER[encoding];
        const top = Math.min(y & ~1, height - 2) * stride;
        for (let x = 0; x < width; x++) {
          const left = top + Math.min(x & ~1, width - 2);
          const square = (/** @type {number} */ i) => data[left + (i & 1) + (i >> 1) * stride];
          out[to++] = OPAQUE | (square(order[3]) << 16) | (((square(order[1]) + square(order[2])) >> 1) << 8) | square(order[0]);
        }
      }
    }
  }
}
