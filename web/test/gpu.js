// Lets WebGL say that a GPU draws it.
const get = WebGL2RenderingContext.prototype.getParameter;
WebGL2RenderingContext.prototype.getParameter = function (name) {
  return name === 37446 ? "GPU" : get.call(this, name); // UNMASKED_RENDERER_WEBGL
};
